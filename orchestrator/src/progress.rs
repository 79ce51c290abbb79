//! Live progress: two lines refreshed in place on a terminal, one line every few seconds elsewhere.

use crate::figures::{EpisodeFigures, Recent, recent};
use crate::format;
use crate::metrics::History;
use crate::terminal;
use proto::config::StageConfig;
use proto::control::LearnerEvent;
use proto::reward::RewardKind;
use std::time::Duration;

/// Without a terminal that can be refreshed, a line as often as this.
const LINE_EVERY: Duration = Duration::from_secs(5);

/// What the learner does at the moment, as far as it has said.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Doing {
    Starting,
    Collecting(u64),
    Updating(u64),
    WaitingFor { actor: u32, seconds: u64 },
    Leaving,
}

/// Shows how a run gets on.
#[derive(Debug)]
pub struct Progress {
    stages: Vec<StageConfig>,
    doing: Doing,
    since: Duration,
    last_line: Option<Duration>,
    interactive: bool,
}

impl Progress {
    /// Of a run with these stages.
    pub fn new(stages: Vec<StageConfig>) -> Self {
        let interactive = terminal::interactive();
        Self { stages, doing: Doing::Starting, since: Duration::ZERO, last_line: None, interactive }
    }

    /// Takes note of what the learner says.
    pub fn learner(&mut self, now: Duration, event: &LearnerEvent) {
        let doing = match *event {
            LearnerEvent::Ready { rollout, .. } => Doing::Collecting(rollout),
            LearnerEvent::RolloutCollected { rollout, .. } => Doing::Updating(rollout),
            LearnerEvent::RolloutTrained { rollout, .. } => Doing::Collecting(rollout + 1),
            LearnerEvent::WaitingForActor { actor, waited_s, .. } => {
                Doing::WaitingFor { actor, seconds: waited_s as u64 }
            }
            LearnerEvent::Finished { .. } => Doing::Leaving,
            LearnerEvent::ActorsConnected { .. }
            | LearnerEvent::CheckpointWritten { .. }
            | LearnerEvent::EpisodePlayed { .. } => return,
        };
        self.doing = doing;
        self.since = now;
    }

    /// The learner died.
    pub fn learner_died(&mut self, now: Duration) {
        self.doing = Doing::Starting;
        self.since = now;
    }

    /// Shows where the run stands, if it is time to.
    pub fn show(&mut self, now: Duration, history: &History) {
        if self.interactive {
            let recent = recent(&self.stages, history);
            let mut figures = figures_line(&recent);
            let separator = if figures.is_empty() { "" } else { "  |  " };
            figures.push_str(separator);
            figures.push_str(&self.doing(now));
            terminal::progress(vec![frames_line(&self.stages, &recent), figures]);
        } else if self.last_line.is_none_or(|last| now.saturating_sub(last) >= LINE_EVERY) {
            self.last_line = Some(now);
            let recent = recent(&self.stages, history);
            let parts = [frames_line(&self.stages, &recent), figures_line(&recent), self.doing(now)];
            let parts: Vec<String> = parts.into_iter().filter(|part| !part.is_empty()).collect();
            terminal::note(&parts.join("  |  "));
        }
    }

    /// Takes the progress off the screen.
    pub fn clear(&self) {
        if self.interactive {
            terminal::progress(vec![]);
        }
    }

    fn doing(&self, now: Duration) -> String {
        let time = format::duration(now.saturating_sub(self.since));
        match self.doing {
            Doing::Starting => format!("learner starts, {time}"),
            Doing::Collecting(rollout) => format!("collecting rollout {rollout}, {time}"),
            Doing::Updating(rollout) => format!("updating on rollout {rollout}, {time}"),
            Doing::WaitingFor { actor, seconds } => format!("waiting for actor-{actor:02}, {seconds} s"),
            Doing::Leaving => "leaving".to_owned(),
        }
    }
}

/// Stage, frames, rate and where the time goes, time left.
pub fn frames_line(stages: &[StageConfig], recent: &Recent) -> String {
    let percent = 100.0 * recent.frames as f64 / recent.budget.max(1) as f64;
    let (frames, budget) = (format::count(recent.frames), format::count(recent.budget));
    let stage = recent.stage.and_then(|stage| stages.get(stage));
    let stage =
        stage.map_or_else(String::new, |stage| format!("stage {} ({})  ", stage.name, reward_symbol(stage.reward)));
    let mut parts = vec![format!("{stage}{frames} / {budget} frames  {percent:.1}%")];
    if let Some(rate) = recent.frames_per_s {
        parts.push(format!(
            "{} frames/s: simulate {:.0}% infer {:.0}% update {:.0}%",
            format::rate(rate),
            100.0 * recent.simulate,
            100.0 * recent.infer,
            100.0 * recent.update
        ));
    }
    if let Some(left) = recent.left_s.and_then(|left_s| Duration::try_from_secs_f64(left_s).ok()) {
        parts.push(format!("{} left", format::duration(left)));
    }
    parts.join("  |  ")
}

/// Return, success, disturbance; empty before the first episode has ended.
pub fn figures_line(recent: &Recent) -> String {
    let EpisodeFigures { episodes, mean_return, success, success_without_disturbance, disturbance_m } = recent.episodes;
    if episodes == 0 {
        return String::new();
    }
    let percent = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{:.1}%", 100.0 * value));
    let number = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.2}"));
    format!(
        "return {}  success {}  undisturbed {}  disturbance {} m",
        number(mean_return),
        percent(success),
        percent(success_without_disturbance),
        disturbance_m.map_or_else(|| "-".to_owned(), |value| format!("{value:.3}")),
    )
}

/// The reward as the paper writes it.
pub fn reward_symbol(reward: RewardKind) -> &'static str {
    match reward {
        RewardKind::Task => "r",
        RewardKind::DisturbanceFree => "r′",
        RewardKind::Lagrangian => "r-λd",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figures::tests::{history, stages};

    #[test]
    fn lines_read_as_they_should() {
        let recent = recent(&stages(), &history(22));
        assert_eq!(
            frames_line(&stages(), &recent),
            "stage II (r′)  1 100 / 1 500 frames  73.3%  |  25.0 frames/s: simulate 40% infer 20% update 30%  |  16 s left"
        );
        assert_eq!(figures_line(&recent), "return 20.75  success 50.0%  undisturbed -  disturbance 0.250 m");
    }

    #[test]
    fn before_the_first_rollout_there_are_only_frames() {
        let recent = recent(&stages(), &History::default());
        assert_eq!(frames_line(&stages(), &recent), "0 / 1 500 frames  0.0%");
        assert_eq!(figures_line(&recent), "");
    }
}
