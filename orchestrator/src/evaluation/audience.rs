use super::journal;
use super::progress::Progress;
use crate::output::format;
use crate::output::terminal::Live;
use crate::run::json_lines::Writer;
use crate::supervisor::shell::Audience;
use anyhow::{Result, ensure};
use proto::evaluation::{EpisodeRecord, Plan};
use proto::event::LearnerEvent;
use proto::kitchen::KitchenId;
use proto::run_folder::RunFolder;
use proto::task::Spec;
use recording::recorder::Recorder;
use std::collections::BTreeMap;
use std::time::Duration;
use wire::fault;

pub struct EvaluationAudience {
    spec: &'static Spec,
    plan: Plan,
    journal: Writer,
    records: BTreeMap<(KitchenId, u32), (EpisodeRecord, Vec<u8>)>,
    pub frames: u64,
    pub parameters: u64,
    pub device: String,
    /// When the actors had answered, and when the last episode ended.
    span: Option<(Duration, Duration)>,
    live: Live,
    is_stopped: bool,
}

impl EvaluationAudience {
    pub fn new(spec: &'static Spec, plan: Plan, folder: &RunFolder) -> Result<Self> {
        Ok(Self {
            spec,
            plan,
            journal: journal::open(folder)?,
            records: BTreeMap::new(),
            frames: 0,
            parameters: 0,
            device: String::new(),
            span: None,
            live: Live::default(),
            is_stopped: false,
        })
    }

    pub fn asked(&self) -> usize {
        self.plan.len()
    }

    pub fn played(&self) -> usize {
        self.records.len()
    }

    pub fn wall(&self) -> Duration {
        self.span.map(|(began, ended)| ended.saturating_sub(began)).unwrap_or_default()
    }

    pub fn records(&self) -> Result<Vec<(EpisodeRecord, Vec<u8>)>> {
        let played = self.records.keys().copied().collect::<Vec<_>>();
        ensure!(
            played == self.plan.episodes().collect::<Vec<_>>(),
            "the learner calls the evaluation complete with {} episodes of {}",
            played.len(),
            self.plan.len()
        );
        Ok(self.records.values().cloned().collect())
    }

    fn line(&self, now: Duration, columns: Option<usize>) -> String {
        let (played, asked) = (self.played(), self.asked());
        let records = self.records.values().map(|(record, _)| record);
        let left = |(began, _)| {
            let elapsed_s = now.saturating_sub(began).as_secs_f64();
            let left_s = elapsed_s / played as f64 * (asked - played) as f64;
            (played > 0 && !self.is_stopped)
                .then(|| format!("{} left", format::duration(Duration::from_secs_f64(left_s))))
        };
        let left = self.span.map_or_else(|| Some("starting".to_owned()), left);
        Progress::of(self.spec, asked as u64, records).line(left, columns)
    }
}

impl Audience for EvaluationAudience {
    fn learner(&mut self, now: Duration, event: &LearnerEvent) -> Result<()> {
        match event {
            LearnerEvent::Ready { frames, device, parameters, .. } => {
                // One that was started again begins again.
                self.records.clear();
                self.journal.clear()?;
                self.span = None;
                self.frames = *frames;
                self.parameters = *parameters;
                self.device.clone_from(device);
            }
            LearnerEvent::ActorsConnected { .. } => self.span = Some((now, now)),
            LearnerEvent::EpisodePlayed { record, actions } => {
                if let Some((_, ended)) = &mut self.span {
                    *ended = now;
                }
                fault::reach("evaluation.before_record");
                self.journal.append(record)?;
                let twice = self.records.insert((record.kitchen, record.episode), (record.clone(), actions.clone()));
                ensure!(twice.is_none(), "episode {} of kitchen {} was played twice", record.episode, record.kitchen);
            }
            _ => {}
        }
        Ok(())
    }

    fn learner_died(&mut self, _now: Duration) {}

    fn tick(&mut self, now: Duration, _recorder: Option<&Recorder>) {
        if self.live.is_due(now) {
            self.live.show(self.line(now, self.live.columns()));
        }
    }

    fn stop_asked(&mut self) {
        self.is_stopped = true;
    }

    fn over(&mut self) {
        self.live.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluation::testing;
    use proto::config::Config;
    use proto::evaluation::{EvaluationConfig, ObjectSet};
    use proto::kitchen::Split;

    #[test]
    fn how_far_an_evaluation_is_stands_in_its_folder() {
        let temporary = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(temporary.path());
        let mut config = Config::resolve("demo", None).unwrap();
        assert_eq!(Progress::read(&folder, &config).unwrap(), None, "a run");
        config.actors.count = 5;
        let (split, objects) = (Split::Test, ObjectSet::Novel);
        config.evaluation = Some(EvaluationConfig::fixed(split, objects, 2));
        let plan = config.evaluation_plan().unwrap();
        let episodes: Vec<_> = plan.episodes().collect();
        let mut audience = EvaluationAudience::new(config.spec(), plan, &folder).unwrap();
        let mut hear = |event: LearnerEvent| audience.learner(Duration::ZERO, &event).unwrap();
        let standing = || Progress::read(&folder, &config).unwrap().unwrap();
        let ready = || testing::ready(0, 0, 0);
        let played = |index: usize, success: bool| {
            let (kitchen, episode) = episodes[index];
            let ones: &[&str] = if success { &["success", "success_without_disturbance"] } else { &[] };
            let record = testing::played(kitchen, episode, ones);
            LearnerEvent::EpisodePlayed { record, actions: vec![20] }
        };
        hear(ready());
        let line = || standing().line(None, None);
        assert_eq!(line(), "0 / 10 episodes  0.0%");
        for (index, success) in [(0, true), (1, true), (2, false), (3, false)] {
            hear(played(index, success));
        }
        assert_eq!(line(), "4 / 10 episodes  40.0%  |  SR 50.0%  SRwoD 50.0%  SRwoD (per axis) 0.0%");
        let narrow = standing().line(Some("7 s left".to_owned()), Some(60));
        assert_eq!(narrow, "4 / 10 episodes  40.0% | 7 s left | SR 50.0% | SRwoD 50.0%");
        // A learner that was started again plays all of them again.
        hear(ready());
        hear(played(0, true));
        assert_eq!((standing().played, standing().means["success"], standing().result), (1, Some(1.0), None));
        // Whoever has stopped it waits for no more of them.
        audience.span = Some((Duration::ZERO, Duration::from_secs(4)));
        let left = |audience: &EvaluationAudience| audience.line(Duration::from_secs(4), None).contains(" left");
        assert!(left(&audience));
        audience.stop_asked();
        assert!(!left(&audience));
    }
}
