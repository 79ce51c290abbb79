//! Live progress: one line that renews itself on a terminal, below the log; a longer one every few seconds elsewhere.
//!
//! No crate for progress bars: theirs count to a total, these lines show stages, shares of time and metrics.

use super::means::{EpisodeMeans, Recent, recent};
use crate::output::format;
use crate::output::table::fitting;
use crate::output::terminal::Live;
use proto::config::{Config, StageConfig};
use proto::event::LearnerEvent;
use proto::stage::position_at;
use proto::task::Described;
use proto::trained::History;
use std::time::Duration;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Doing {
    Starting,
    Collecting(u64),
    Updating(u64),
    /// With `ppo.overlap`: of which rollout the update runs beside the collecting of the next.
    Both(u64),
    Leaving {
        complete: bool,
    },
}

/// A learner has said that somebody keeps it waiting. It says so every ten seconds, of the recorder every
/// second, and not when that is over.
#[derive(Debug, Clone, Copy)]
struct Waiting {
    /// None: the recorder.
    actor: Option<u32>,
    seconds: u64,
    said: Duration,
}

const WAITING_SHOWN: Duration = Duration::from_secs(12);

pub struct Progress {
    metrics: Vec<Described>,
    stages: Vec<StageConfig>,
    overlap: bool,
    doing: Doing,
    /// Whether a rollout was trained since the learner began.
    trains: bool,
    is_stopped: bool,
    since: Duration,
    waiting: Option<Waiting>,
    live: Live,
}

impl Progress {
    pub fn new(config: &Config) -> Self {
        let (doing, since, waiting) = (Doing::Starting, Duration::ZERO, None);
        let (metrics, stages, overlap) = (config.spec().shown(), config.stages.clone(), config.ppo.overlap);
        Self {
            metrics,
            stages,
            overlap,
            doing,
            trains: false,
            is_stopped: false,
            since,
            waiting,
            live: Live::default(),
        }
    }

    pub fn learner(&mut self, now: Duration, event: &LearnerEvent) {
        let doing = match *event {
            LearnerEvent::Ready { rollout, .. } => Doing::Collecting(rollout),
            // A stage begins after the last update of the one before.
            LearnerEvent::RolloutCollected { rollout, frames, .. }
                if self.overlap && position_at(&self.stages, frames).is_some_and(|next| next.frames_in_stage > 0) =>
            {
                Doing::Both(rollout)
            }
            LearnerEvent::RolloutCollected { rollout, .. } => Doing::Updating(rollout),
            LearnerEvent::RolloutTrained { rollout, .. } => Doing::Collecting(rollout + 1),
            LearnerEvent::WaitingForActor { actor, waited_s, .. } => {
                self.waiting = Some(Waiting { actor: Some(actor), seconds: waited_s as u64, said: now });
                return;
            }
            LearnerEvent::WaitingForRecorder { waited_s, .. } => {
                self.waiting = Some(Waiting { actor: None, seconds: waited_s as u64, said: now });
                return;
            }
            LearnerEvent::Finished { complete, .. } => Doing::Leaving { complete },
            LearnerEvent::ActorsConnected { .. }
            | LearnerEvent::CheckpointBegun { .. }
            | LearnerEvent::CheckpointWritten { .. }
            | LearnerEvent::EpisodePlayed { .. } => return,
        };
        self.trains |= matches!(event, LearnerEvent::RolloutTrained { .. });
        self.doing = doing;
        self.since = now;
        self.waiting = None;
    }

    pub fn learner_died(&mut self, now: Duration) {
        if !matches!(self.doing, Doing::Leaving { .. }) {
            self.doing = Doing::Starting;
            self.trains = false;
            self.since = now;
            self.waiting = None;
        }
    }

    pub fn stop_asked(&mut self) {
        self.is_stopped = true;
    }

    /// Shows the progress of the run, if it is time to. `validating`: whether a checkpoint is being validated or waits
    /// for it.
    pub fn show(&mut self, now: Duration, history: &History, validating: bool) {
        if self.live.is_due(now) {
            let line = self.line(now, history, validating, self.live.columns());
            self.live.show(line);
        }
    }

    fn line(&self, now: Duration, history: &History, validating: bool, columns: Option<usize>) -> String {
        let recent = recent(&self.stages, history, !self.trains || self.is_stopped);
        let doing = self.doing(now, validating);
        if let Some(columns) = columns {
            return short_line(&self.metrics, &self.stages, &recent, &doing, self.is_usual(now), columns);
        }
        let parts = [frames_line(&self.stages, &recent), figures_line(&self.metrics, &recent), doing];
        parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(BETWEEN)
    }

    /// Nothing that whoever watches should know first.
    fn is_usual(&self, now: Duration) -> bool {
        self.waiting(now).is_none() && matches!(self.doing, Doing::Collecting(_) | Doing::Updating(_) | Doing::Both(_))
    }

    fn waiting(&self, now: Duration) -> Option<Waiting> {
        self.waiting.filter(|waiting| now.saturating_sub(waiting.said) < WAITING_SHOWN)
    }

    pub fn clear(&self) {
        self.live.clear();
    }

    fn doing(&self, now: Duration, validating: bool) -> String {
        if let Some(Waiting { actor, seconds, .. }) = self.waiting(now) {
            return match actor {
                Some(actor) => format!("waiting for actor-{actor:02}, {seconds} s"),
                None => format!("waiting for the recording, {seconds} s"),
            };
        }
        let time = format::duration(now.saturating_sub(self.since));
        match self.doing {
            Doing::Starting => format!("learner starts, {time}"),
            Doing::Collecting(rollout) => format!("collecting rollout {rollout}, {time}"),
            Doing::Updating(rollout) => format!("updating on rollout {rollout}, {time}"),
            Doing::Both(rollout) => format!("updating on rollout {rollout}, collecting {}, {time}", rollout + 1),
            Doing::Leaving { complete: true } if validating => {
                format!("training is complete, waiting for the last validation, {time}")
            }
            Doing::Leaving { .. } => "leaving".to_owned(),
        }
    }
}

pub const BETWEEN: &str = "  |  ";

/// As much as fits so many columns, the most important first.
pub fn short_line(
    metrics: &[Described],
    stages: &[StageConfig],
    recent: &Recent,
    doing: &str,
    is_usual: bool,
    columns: usize,
) -> String {
    let percent = 100.0 * recent.frames as f64 / recent.budget.max(1) as f64;
    let stage = stage_of(stages, recent).map_or_else(String::new, |stage| format!("{}  ", stage.name));
    let (frames, budget) = (format::count(recent.frames), format::count(recent.budget));
    let EpisodeMeans { mean_return, figures, .. } = &recent.episodes;
    let known = metrics.iter().filter(|metric| figures.contains_key(&metric.name));
    let known = known.map(|metric| Some(format::metrics([metric], figures, "")));
    let Recent { simulate, infer, update, .. } = recent;
    let shares = [simulate, infer, update].map(|share| format!("{:.0}", 100.0 * share)).join("/");
    let before = [
        Some(format!("{stage}{frames} / {budget}  {percent:.1}%")),
        Some(doing.to_owned()).filter(|_| !is_usual),
        time_left(recent),
        recent.frames_per_s.map(|rate| format!("{} frames/s", format::rate(rate))),
    ];
    let after = [
        mean_return.filter(|_| !is_shown(metrics, &recent.episodes)).map(|mean| format!("return {mean:.2}")),
        Some(doing.to_owned()).filter(|_| is_usual),
        recent.frames_per_s.map(|_| format!("simulate/infer/update {shares}%")),
    ];
    fitting(before.into_iter().chain(known).chain(after).flatten(), columns)
}

fn time_left(recent: &Recent) -> Option<String> {
    let left_s = recent.left_s.filter(|_| recent.frames < recent.budget)?;
    Some(format!("{} left", format::duration(Duration::try_from_secs_f64(left_s).ok()?)))
}

/// The stage that a run is in; none of one with all its frames.
fn stage_of<'a>(stages: &'a [StageConfig], recent: &Recent) -> Option<&'a StageConfig> {
    recent.stage.filter(|_| recent.frames < recent.budget).and_then(|stage| stages.get(stage))
}

pub fn frames_line(stages: &[StageConfig], recent: &Recent) -> String {
    let percent = 100.0 * recent.frames as f64 / recent.budget.max(1) as f64;
    let (frames, budget) = (format::count(recent.frames), format::count(recent.budget));
    let stage = stage_of(stages, recent)
        .map_or_else(String::new, |stage| format!("stage {} ({})  ", stage.name, format::reward(&stage.reward)));
    let mut parts = vec![format!("{stage}{frames} / {budget} frames  {percent:.1}%")];
    if let Some(rate) = recent.frames_per_s {
        parts.push(format!(
            "{} frames/s{}: simulate {:.0}% infer {:.0}% update {:.0}%",
            format::rate(rate),
            if recent.left_s.is_some() { " now" } else { ", mean" },
            100.0 * recent.simulate,
            100.0 * recent.infer,
            100.0 * recent.update
        ));
    }
    parts.extend(time_left(recent));
    parts.join(BETWEEN)
}

/// Whether the return is one of the metrics, as where a reward is the score.
fn is_shown(metrics: &[Described], means: &EpisodeMeans) -> bool {
    means.mean_return.is_some() && metrics.iter().any(|one| one.mean(&means.figures) == means.mean_return)
}

pub fn figures_line(metrics: &[Described], recent: &Recent) -> String {
    let EpisodeMeans { episodes, mean_return, figures } = &recent.episodes;
    if *episodes == 0 {
        return String::new();
    }
    let figures = format::metrics(metrics, figures, "  ");
    if is_shown(metrics, &recent.episodes) {
        return figures;
    }
    format!("return {}  {figures}", format::number(*mean_return, 2))
}

#[cfg(test)]
mod tests {
    use super::super::means::tests::{history, stages};
    use super::*;
    use proto::task::Kind;
    use std::collections::BTreeMap;

    fn config(overlap: bool) -> Config {
        let mut config = Config { stages: stages(), ..Config::default() };
        config.ppo.overlap = overlap;
        config
    }

    fn seconds(count: u64) -> Duration {
        Duration::from_secs(count)
    }

    fn trained(rollout: u64, frames: u64) -> LearnerEvent {
        let (timing, metrics) = (proto::event::Timing::default(), BTreeMap::new());
        LearnerEvent::RolloutTrained { rank: 0, rollout, frames, stage: u32::from(frames > 1000), timing, metrics }
    }

    /// Only `ArmPointNav`'s metrics were shown of any task.
    #[test]
    fn another_tasks_metrics_are_shown_in_their_own_words() {
        let metric = |name: &str, label: &str, unit: &str, kind| {
            let [name, label, unit] = [name, label, unit].map(str::to_owned);
            Described { name, label, unit, kind, doc: String::new(), quotient: None }
        };
        let metrics = [metric("arrived", "SR", "", Kind::Share), metric("path_m", "path", "m", Kind::F32)];
        let mut history = history(22);
        let mut newest = history.iter().next_back().unwrap().clone();
        newest.metrics = [("episode/count", 1.0), ("episode/arrived", 0.75), ("episode/path_m", 3.5)]
            .map(|(name, value)| (name.to_owned(), value))
            .into_iter()
            .collect::<BTreeMap<_, _>>()
            .into();
        history.rewind_to(20);
        history.insert(newest);
        let recent = recent(&stages(), &history, false);
        assert_eq!(figures_line(&metrics, &recent), "return –  SR 75.0%  path 3.500 m");
        let mut same = recent.clone();
        same.episodes.mean_return = same.episodes.figures.get("path_m").copied();
        assert_eq!(figures_line(&metrics, &same), "SR 75.0%  path 3.500 m", "the return is the path");
        let line = short_line(&metrics, &stages(), &recent, "updating", true, 200);
        assert!(line.contains("frames/s | SR 75.0% | path 3.500 m | updating"), "{line}");
    }

    #[test]
    fn at_the_end_nothing_is_left_but_the_validation_that_is_waited_for() {
        let finished = |complete| LearnerEvent::Finished { rank: 0, frames: 1500, weights: "f".repeat(64), complete };
        let mut progress = Progress::new(&config(false));
        progress.learner_died(seconds(3));
        assert_eq!(progress.doing(seconds(4), true), "learner starts, 1 s");
        progress.learner(seconds(10), &finished(true));
        assert_eq!(progress.doing(seconds(11), false), "leaving");
        progress.learner_died(seconds(12));
        let waiting = "training is complete, waiting for the last validation, 20 s";
        assert_eq!(progress.doing(seconds(30), true), waiting);
        assert_eq!(progress.doing(seconds(30), false), "leaving");
        // Whoever stops waits for none.
        progress.learner(seconds(10), &finished(false));
        progress.learner_died(seconds(12));
        assert_eq!(progress.doing(seconds(30), true), "leaving");
        let frames = frames_line(&stages(), &recent(&stages(), &history(30), false));
        assert!(frames.starts_with("1,500 / 1,500 frames  100.0%") && !frames.contains("left"), "{frames}");
        assert!(frames.contains("25.0 frames/s, mean: simulate"), "{frames}");
    }

    #[test]
    fn before_a_rollout_is_trained_no_rate_is_of_now_and_no_time_is_left() {
        let mut progress = Progress::new(&config(false));
        let lines = |progress: &Progress| {
            [None, Some(200)].map(|columns| progress.line(seconds(3), &history(22), false, columns)).join("\n")
        };
        let is_idle = |lines: &str| lines.contains("25.0 frames/s, mean") && !lines.contains(" left");
        assert!(is_idle(&lines(&progress)), "{}", lines(&progress));
        let ready = LearnerEvent::RolloutCollected { rank: 0, rollout: 22, frames: 1150, here: 50 };
        progress.learner(seconds(1), &ready);
        assert!(is_idle(&lines(&progress)), "{}", lines(&progress));
        progress.learner(seconds(2), &trained(22, 1150));
        let trains = lines(&progress);
        assert!(trains.contains("25.0 frames/s now") && trains.matches(" left").count() == 2, "{trains}");
        let mut stopped = Progress::new(&config(false));
        stopped.learner(seconds(2), &trained(22, 1150));
        stopped.stop_asked();
        assert!(is_idle(&lines(&stopped)), "{}", lines(&stopped));
        progress.learner_died(seconds(3));
        assert!(is_idle(&lines(&progress)), "{}", lines(&progress));
    }

    #[test]
    fn with_overlap_a_rollout_is_collected_beside_every_update_but_a_stages_last() {
        let end = stages()[0].frames;
        let doing = |overlap, frames| {
            let mut progress = Progress::new(&config(overlap));
            progress.learner(seconds(1), &LearnerEvent::RolloutCollected { rank: 0, rollout: 7, frames, here: 50 });
            progress.doing(seconds(3), false)
        };
        assert_eq!(doing(true, end - 1), "updating on rollout 7, collecting 8, 2 s");
        assert_eq!(doing(true, end), "updating on rollout 7, 2 s");
        assert_eq!(doing(false, end - 1), "updating on rollout 7, 2 s");
    }

    #[test]
    fn an_actor_that_is_waited_for_is_named_as_long_as_that_is_said() {
        let mut progress = Progress::new(&config(false));
        progress.learner(seconds(10), &trained(4, 50));
        progress.learner(seconds(20), &LearnerEvent::WaitingForActor { rank: 1, actor: 3, waited_s: 2.0 });
        assert_eq!(progress.doing(seconds(31), false), "waiting for actor-03, 2 s");
        assert!(!progress.is_usual(seconds(31)));
        // It has answered, which nobody says.
        assert_eq!(progress.doing(seconds(33), false), "collecting rollout 5, 23 s");
        assert!(progress.is_usual(seconds(33)));
        progress.learner(seconds(35), &LearnerEvent::WaitingForRecorder { rank: 1, waited_s: 4.9 });
        assert_eq!(progress.doing(seconds(36), false), "waiting for the recording, 4 s");
        progress.learner(seconds(40), &LearnerEvent::WaitingForActor { rank: 0, actor: 3, waited_s: 2.0 });
        progress.learner(seconds(41), &LearnerEvent::RolloutCollected { rank: 0, rollout: 5, frames: 60, here: 10 });
        assert_eq!(progress.doing(seconds(42), false), "updating on rollout 5, 1 s");
    }
}
