//! All that was measured, as a table with ratios.

use crate::cell::{Figures, Setting};
use crate::end::Way;

/// At eight frames the wire carries at least this much of what raw shared memory does.
const BAR: (u32, f64) = (8, 0.9);

/// One way with one size, in all rounds.
#[derive(Debug)]
pub struct Row {
    setting: Setting,
    rounds: Vec<Figures>,
}

impl Row {
    pub fn new(setting: Setting, figures: Figures) -> Self {
        Self { setting, rounds: vec![figures] }
    }

    pub fn is_of(&self, setting: &Setting) -> bool {
        self.setting == *setting
    }

    pub fn add(&mut self, figures: Figures) {
        self.rounds.push(figures);
    }

    pub fn frames(&self) -> u32 {
        self.setting.frames
    }

    /// The median over rounds of each figure.
    fn median(&self) -> Figures {
        let median = |figure: fn(&Figures) -> f64| {
            let mut values: Vec<f64> = self.rounds.iter().map(figure).collect();
            values.sort_by(f64::total_cmp);
            f64::midpoint(values[(values.len() - 1) / 2], values[values.len() / 2])
        };
        Figures {
            frames_per_s: median(|figures| figures.frames_per_s),
            p50_us: median(|figures| figures.p50_us),
            p99_us: median(|figures| figures.p99_us),
            cpu_us: median(|figures| figures.cpu_us),
        }
    }

    fn name(&self) -> String {
        let recorder = if self.setting.recorded { " + recorder" } else { "" };
        format!("{}{recorder}", self.setting.way)
    }
}

/// The row that others of the same size are compared with.
fn base(rows: &[Row], frames: u32) -> Option<Figures> {
    rows.iter().find(|row| row.setting.way == Way::Shm && row.frames() == frames).map(Row::median)
}

pub fn text(rows: &[Row], actors: u32, machine: &str) -> String {
    let mut lines = vec![
        format!("{actors} actors, frames of 224×224 with what belongs to them (125,696 bytes), {machine}"),
        "ratio: beside raw shared memory (shm); round trip: from sending a half to its actions".to_owned(),
        format!(
            "{:>6}  {:<15} {:>10} {:>6}  {:>9} {:>6}  {:>9} {:>6}  {:>13}",
            "frames", "way", "frames/s", "ratio", "p50 µs", "ratio", "p99 µs", "ratio", "CPU µs/frame"
        ),
    ];
    for row in rows {
        let own = row.median();
        let ratio = |figure: fn(&Figures) -> f64| {
            base(rows, row.frames())
                .map_or_else(|| "-".to_owned(), |base| format!("{:.2}", figure(&own) / figure(&base)))
        };
        lines.push(format!(
            "{:>6}  {:<15} {:>10.0} {:>6}  {:>9.0} {:>6}  {:>9.0} {:>6}  {:>13.1}",
            row.frames(),
            row.name(),
            own.frames_per_s,
            ratio(|figures| figures.frames_per_s),
            own.p50_us,
            ratio(|figures| figures.p50_us),
            own.p99_us,
            ratio(|figures| figures.p99_us),
            own.cpu_us,
        ));
    }
    lines.extend(verdict(rows));
    lines.join("\n")
}

/// Whether the bar is reached; none if it was not measured.
fn verdict(rows: &[Row]) -> Option<String> {
    let own = rows.iter().find(|row| row.name() == "wire" && row.frames() == BAR.0)?.median();
    let ratio = own.frames_per_s / base(rows, BAR.0)?.frames_per_s;
    let met = if ratio >= BAR.1 { "met" } else { "MISSED" };
    Some(format!("wire with {} frames: {ratio:.2} of raw shared memory (target at least {}): {met}", BAR.0, BAR.1))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(way: Way, recorded: bool, rates: &[f64]) -> Row {
        let setting = Setting { way, actors: 19, frames: 8, seconds: 1.0, recorded };
        let figures = |&frames_per_s| Figures { frames_per_s, p50_us: 10.0, p99_us: 20.0, cpu_us: 3.0 };
        Row { setting, rounds: rates.iter().map(figures).collect() }
    }

    #[test]
    fn ratios_are_of_medians_and_the_bar_is_judged_without_the_recorder() {
        let rows = [
            row(Way::Wire, true, &[1.0]),
            row(Way::Wire, false, &[85.0, 1000.0, 95.0]),
            row(Way::Shm, false, &[100.0]),
        ];
        let text = text(&rows, 19, "2 cores");
        assert!(text.contains("0.95 of raw shared memory (target at least 0.9): met"), "{text}");
        assert!(text.contains("wire + recorder") && text.contains("0.01"), "{text}");
        assert_eq!(verdict(&rows[..2]), None);
        let slow = [row(Way::Wire, false, &[80.0]), row(Way::Shm, false, &[100.0])];
        assert!(verdict(&slow).unwrap().ends_with("MISSED"));
    }
}
