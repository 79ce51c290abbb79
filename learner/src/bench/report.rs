use super::gpu::Use;
use super::inference::Inference;
use super::update::Updates;
use serde::Serialize;

/// As JSON its times are in seconds.
#[derive(Debug, Serialize)]
pub struct Report {
    pub preset: String,
    #[serde(rename = "device")]
    pub place: String,
    /// The encoder's name; `mlp` without a frame.
    pub encoder: &'static str,
    pub parameters: u64,
    pub inference: Vec<Inference>,
    pub updates: Vec<Updates>,
}

impl Report {
    pub fn table(&self) -> String {
        let Self { preset, place, encoder, parameters, .. } = self;
        let mut lines = vec![format!("{preset} on {place}; {encoder}, {:.2} M weights", *parameters as f64 / 1e6)];
        lines.push(format!(
            "{:<22} {:>9} {:>9} {:>9} {:>12} {:>9} {:>10}",
            "inference of", "p50 ms", "p99 ms", "copy ms", "frames/s", "GPU busy", "GPU memory"
        ));
        for Inference { batch, p50_s, p99_s, copy_s, gpu } in &self.inference {
            let [busy, memory] = cells(*gpu);
            let milliseconds = |seconds: f64| format!("{:.2}", 1e3 * seconds);
            let [p50, p99] = [*p50_s, *p99_s].map(milliseconds);
            let copy = copy_s.map_or_else(|| "-".to_owned(), milliseconds);
            let rate = f64::from(*batch) / p50_s;
            lines.push(format!("{batch:<22} {p50:>9} {p99:>9} {copy:>9} {rate:>12.0} {busy:>9} {memory:>10}"));
        }
        lines.push(format!(
            "{:<22} {:>9} {:>9} {:>9} {:>12} {:>9} {:>10}",
            "update of T × envs", "epochs", "epoch ms", "whole ms", "frames/s *", "GPU busy", "GPU memory"
        ));
        for update in &self.updates {
            let [busy, memory] = cells(update.gpu);
            lines.push(format!(
                "{:<22} {:>9} {:>9.1} {:>9.1} {:>12.0} {:>9} {:>10}",
                format!("{} × {}", update.steps, update.environments),
                update.epochs,
                1e3 * update.epoch_s,
                1e3 * update.update_s,
                update.frames as f64 / update.epoch_s,
                busy,
                memory,
            ));
        }
        lines.push("* of one epoch: forward, backward, clip, Adam".to_owned());
        lines.join("\n")
    }
}

fn cells(gpu: Option<Use>) -> [String; 2] {
    gpu.map_or_else(
        || ["-"; 2].map(str::to_owned),
        |Use { busy, memory }| [format!("{:.0}%", 100.0 * busy), format!("{:.1} GB", memory as f64 / 1e9)],
    )
}
