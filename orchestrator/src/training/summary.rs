//! The end of a run: `summary.json` and what is printed. Its last two lines are for scripts: `weights: ` and 64 hex
//! digits, `frames: ` and a count; a run that failed has neither.

use crate::output::table::{is_wider, right_aligned};
use crate::output::{format, terminal};
use crate::run::damaged;
use crate::run::identity::Identity;
use crate::supervisor::event::SessionEnd;
use crate::training::means::{EpisodeMeans, StageMeans, by_stage};
use crate::training::next_steps;
use crate::training::restarts::restarts;
use crate::training::wall::Wall;
use anyhow::{Context, Result};
use proto::SCHEMA_VERSION;
use proto::config::Config;
use proto::run_folder::{RolloutName, RunFolder, write_atomically};
use proto::task::Described;
use proto::trained::History;
use recording::files_at;
use serde::{Deserialize, Serialize};
use std::fmt::{Display, Formatter};
use std::path::PathBuf;
use std::time::Duration;

/// What a run was to have and has not, though its budget is reached. The next `resume` makes it up, if that can be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Missing {
    Validation(u64),
    Best,
    TensorBoard,
}

impl Missing {
    pub fn can_be_made(self, folder: &RunFolder) -> bool {
        match self {
            Self::Validation(rollout) => folder.validation(rollout).join(RolloutName::Manifest.of(rollout)).is_file(),
            Self::Best | Self::TensorBoard => true,
        }
    }
}

impl Display for Missing {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Validation(rollout) => write!(f, "the validation after rollout {rollout}"),
            Self::Best => f.write_str("`best`, which names the best checkpoint,"),
            Self::TensorBoard => f.write_str("a part of TensorBoard's files"),
        }
    }
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    pub schema_version: u32,
    pub id: String,
    pub preset: String,
    pub seed: u64,
    pub complete: bool,
    pub frames: u64,
    pub budget: u64,
    pub weights: String,
    pub stages: Vec<StageMeans>,
    /// Rollouts whose figures are lost: the means above are without them. 0 is not written.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub lost_rollouts: u64,
    pub training_s: f64,
    pub frames_per_s: f64,
    /// Wall time from the beginning of each start to its end; a start that was killed counts until its last rollout.
    /// None in summaries of older versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wall: Option<Wall>,
    /// Whether the recordings hold every step of the run. None without recordings, and in summaries of older versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recording_complete: Option<bool>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub missing: Vec<Missing>,
    pub incarnations: u32,
    pub recordings: Vec<PathBuf>,
}

impl Summary {
    pub fn of(
        folder: &RunFolder,
        config: &Config,
        history: &History,
        identity: &Identity,
        wall: Wall,
        (frames, weights): (u64, &str),
    ) -> Self {
        let training_s: f64 = history.iter().map(|trained| trained.timing.total_s()).sum();
        let budget = proto::stage::total_frames(&config.stages);
        Self {
            schema_version: SCHEMA_VERSION,
            id: identity.id.clone(),
            preset: config.preset.clone(),
            seed: config.seed,
            complete: frames == budget,
            frames,
            budget,
            weights: weights.to_owned(),
            stages: by_stage(&config.stages, history)
                .into_iter()
                .map(|stage| stage.with_quotients(config.spec()))
                .collect(),
            lost_rollouts: lost_rollouts(history),
            training_s,
            frames_per_s: if training_s > 0.0 { frames as f64 / training_s } else { 0.0 },
            wall: Some(wall),
            recording_complete: None,
            missing: Vec::new(),
            incarnations: identity.incarnations.len() as u32,
            recordings: recordings(folder),
        }
    }

    pub fn is_whole(&self) -> bool {
        self.missing.is_empty() && self.recording_complete != Some(false)
    }

    pub fn write(&self, folder: &RunFolder) -> Result<()> {
        let mut text = serde_json::to_string_pretty(self).context("summary.json")?;
        text.push('\n');
        write_atomically(&folder.summary(), text.as_bytes())
            .with_context(|| format!("cannot write {}", folder.summary().display()))
    }

    pub fn read(folder: &RunFolder) -> Result<Option<Self>> {
        let path = folder.summary();
        match folder.read_text(&path) {
            Ok(text) => serde_json::from_str(&text).map(Some).with_context(|| {
                let resume = next_steps::resume(&next_steps::program(), folder.root());
                damaged(&path, &format!("delete it, and `{resume}` writes it anew"))
            }),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error).with_context(|| path.display().to_string()),
        }
    }

    /// As people read it. A failed run has no result, so the two lines for scripts are missing then.
    pub fn lines(&self, metrics: &[Described], folder: &RunFolder, end: &SessionEnd) -> Vec<String> {
        let state = end.ending();
        let mut lines = vec![format!(
            "run {} {state}: preset {}, seed {}, {} of {} frames",
            self.id,
            self.preset,
            self.seed,
            format::count(self.frames),
            format::count(self.budget)
        )];
        lines.extend(table(metrics, &self.stages));
        lines.extend(self.stages.iter().filter_map(|stage| {
            stage.multiplier.map(|multiplier| format!("stage {}: multiplier λ {multiplier:.4}", stage.name))
        }));
        if self.lost_rollouts > 0 {
            let rollouts = format::counted(self.lost_rollouts, "rollout");
            lines.push(format!("the figures of {rollouts} are lost: the table is without them (the weights are not)"));
        }
        let training = Duration::try_from_secs_f64(self.training_s).unwrap_or_default();
        let wall = self.wall.map_or_else(String::new, |wall| format!(", {}", wall.text(self.incarnations)));
        lines.push(format!(
            "training time {}{wall}, {} frames/s",
            format::duration(training),
            format::rate(self.frames_per_s)
        ));
        lines.extend(restarts(folder));
        lines.push(format!("run folder  {}", folder.root().display()));
        match self.recordings.as_slice() {
            [] => {}
            [one] => lines.push(format!("recording   {}", folder.root().join(one).display())),
            many => lines.push(format!("recordings  {} ({} files)", folder.recordings().display(), many.len())),
        }
        if self.recording_complete == Some(false) {
            lines.push("ERROR       the recordings do not hold every step of the run: see the error below".to_owned());
        }
        for missing in &self.missing {
            let resume = next_steps::resume(&next_steps::program(), folder.root());
            lines.push(format!("ERROR       {missing} is missing: `{resume}` tries again"));
        }
        if !matches!(end, SessionEnd::Failed(_) | SessionEnd::HostLost(_)) {
            lines.push(format!("weights: {}", self.weights));
            lines.push(format!("frames: {}", self.frames));
        }
        lines
    }
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde's derive calls it so")]
fn is_zero(count: &u64) -> bool {
    *count == 0
}

fn lost_rollouts(history: &History) -> u64 {
    let end = history.iter().next_back().map_or(0, |last| last.rollout + 1);
    end - history.len() as u64
}

fn recordings(folder: &RunFolder) -> Vec<PathBuf> {
    let files = files_at(folder.root()).unwrap_or_default();
    files.into_iter().filter_map(|path| path.strip_prefix(folder.root()).map(PathBuf::from).ok()).collect()
}

/// Nothing of a run that has trained no rollout.
pub fn table(metrics: &[Described], stages: &[StageMeans]) -> Vec<String> {
    if stages.is_empty() {
        return Vec::new();
    }
    let header = ["stage", "reward", "frames", "episodes", "return"].map(str::to_owned);
    let mut rows: Vec<Vec<String>> =
        vec![header.into_iter().chain(metrics.iter().map(|metric| metric.label.clone())).collect()];
    for stage in stages {
        let late = &stage.last_tenth;
        let of_engine = [
            stage.name.clone(),
            format::reward(&stage.reward).to_owned(),
            format::count(stage.frames),
            format::count(stage.whole.episodes),
            format!("{} -> {}", format::number(stage.first_tenth.mean_return, 2), format::number(late.mean_return, 2)),
        ];
        let of_task = metrics.iter().map(|metric| format::metric(metric, metric.mean(&late.figures)));
        rows.push(of_engine.into_iter().chain(of_task).collect());
    }
    let mut lines = right_aligned(&rows, 2);
    if terminal::width().is_some_and(|most| is_wider(&lines, most)) {
        lines = right_aligned(&transposed(&rows), 1);
    }
    let means = "training, newest tenth of each stage; return: first tenth -> newest tenth";
    let is_unknown = |means: &EpisodeMeans| means.mean_return.is_none();
    let has_none = stages.iter().any(|stage| is_unknown(&stage.first_tenth) || is_unknown(&stage.last_tenth));
    lines.push(if has_none { format!("{means}; –: no episode ended there") } else { means.to_owned() });
    let is_whole = |stage: &&StageMeans| {
        stage.whole.episodes > 0 && stage.frames > stage.budget / 10 && stage.last_tenth == stage.whole
    };
    let whole = stages.iter().filter(is_whole);
    lines.extend(whole.map(|stage| format!("stage {}: means over all of its episodes", stage.name)));
    lines
}

fn transposed(rows: &[Vec<String>]) -> Vec<Vec<String>> {
    (0..rows[0].len()).map(|column| rows.iter().map(|row| row[column].clone()).collect()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::training::means::tests::{history, stages};

    fn metrics() -> Vec<Described> {
        Config::default().spec().shown()
    }

    fn summary() -> Summary {
        let config = Config { stages: stages(), ..Config::default() };
        let folder = RunFolder::new("/nowhere/run");
        let mut identity = Identity { id: "0a1b".to_owned(), ..Identity::new().unwrap() };
        identity.begin_incarnation();
        identity.begin_incarnation();
        let wall = Wall { all_starts_s: 75.0, last_start_s: 61.0 };
        Summary::of(&folder, &config, &history(30), &identity, wall, (1500, &"f".repeat(64)))
    }

    #[test]
    fn lost_figures_are_said_to_be() {
        let mut history = history(30);
        let lines = |history: &History| {
            let lost_rollouts = lost_rollouts(history);
            let summary = Summary { lost_rollouts, ..summary() };
            assert_eq!(serde_json::to_string(&summary).unwrap().contains("lost"), lost_rollouts > 0);
            summary.lines(&metrics(), &RunFolder::new("/nowhere/run"), &SessionEnd::Complete).join("\n")
        };
        assert!(!lines(&history).contains("lost"));
        let last = history.iter().next_back().unwrap().clone();
        history.rewind_to(20);
        history.insert(last);
        assert!(lines(&history).contains("the figures of 9 rollouts are lost"), "{}", lines(&history));
    }

    #[test]
    fn a_table_too_wide_for_a_terminal_stands_on_its_side() {
        let rows = [["stage", "frames"], ["I", "1,000"]].map(|row| row.map(str::to_owned).to_vec());
        assert_eq!(right_aligned(&rows, 1), ["stage  frames", "I       1,000"]);
        assert_eq!(right_aligned(&transposed(&rows), 1), ["stage       I", "frames  1,000"]);
    }

    #[test]
    fn what_the_means_of_a_stage_are_over_is_said() {
        let mut stages = summary().stages;
        let said = |stages: &[StageMeans]| table(&metrics(), stages).split_off(stages.len() + 1);
        assert!(matches!(&*said(&stages), [tenths] if tenths.ends_with("-> newest tenth")), "{:?}", said(&stages));
        let whole = StageMeans { last_tenth: stages[1].whole.clone(), ..stages[1].clone() };
        assert_eq!(said(&[whole])[1..], ["stage II: means over all of its episodes"]);
        stages[0].last_tenth.mean_return = None;
        assert!(said(&stages)[0].ends_with("; –: no episode ended there"));
        assert_eq!(table(&metrics(), &[]), Vec::<String>::new());
    }

    #[test]
    fn a_failed_run_is_called_so_and_has_no_result() {
        let lines =
            summary().lines(&metrics(), &RunFolder::new("/nowhere/run"), &SessionEnd::Failed("disk full".to_owned()));
        assert!(lines[0].starts_with("run 0a1b failed: "), "{}", lines[0]);
        assert!(!lines.iter().any(|line| line.starts_with("weights:") || line.starts_with("frames:")));
    }
}
