//! What is heard while episodes are played: keeps their records, and shows how it gets on.

use crate::format;
use crate::recorder::Recorder;
use crate::supervisor::shell::Audience;
use crate::terminal::Live;
use anyhow::{Result, ensure};
use proto::control::LearnerEvent;
use proto::evaluation::{EpisodeRecord, Plan};
use proto::kitchen::KitchenId;
use proto::reward::UNDISTURBED_THRESHOLD_M;
use std::collections::BTreeMap;
use std::time::Duration;

/// Records of an evaluation so far.
#[derive(Debug)]
pub struct Examiner {
    plan: Plan,
    records: BTreeMap<(KitchenId, u32), (EpisodeRecord, Vec<u8>)>,
    frames: u64,
    parameters: u64,
    device: String,
    /// When the actors had answered, and when the last episode ended.
    span: Option<(Duration, Duration)>,
    live: Live,
}

impl Examiner {
    /// Of an evaluation with this plan.
    pub fn new(plan: Plan) -> Self {
        Self {
            plan,
            records: BTreeMap::new(),
            frames: 0,
            parameters: 0,
            device: String::new(),
            span: None,
            live: Live::default(),
        }
    }

    /// Episodes to play.
    pub fn asked(&self) -> usize {
        self.plan.len()
    }

    /// Episodes played.
    pub fn played(&self) -> usize {
        self.records.len()
    }

    /// Frames that the weights were trained on.
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// Trainable parameters.
    pub fn parameters(&self) -> u64 {
        self.parameters
    }

    /// What infers.
    pub fn device(&self) -> &str {
        &self.device
    }

    /// From the actors' first answer to the end of the last episode.
    pub fn wall(&self) -> Duration {
        self.span.map(|(began, ended)| ended.saturating_sub(began)).unwrap_or_default()
    }

    /// All records in table order; an error if any is missing.
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

    fn line(&self, now: Duration) -> String {
        let (played, asked) = (self.played(), self.asked());
        let share = |test: &dyn Fn(&EpisodeRecord) -> bool| {
            let count = self.records.values().filter(|(record, _)| test(record)).count();
            format::percent(Some(count as f64 / played.max(1) as f64))
        };
        let mut parts = vec![format!(
            "{} / {} episodes  {:.1}%",
            format::count(played as u64),
            format::count(asked as u64),
            100.0 * played as f64 / asked.max(1) as f64
        )];
        if played > 0 {
            parts.push(format!(
                "SR {}  SRwoD {}",
                share(&|record| record.success),
                share(&|record| record.succeeded_within(UNDISTURBED_THRESHOLD_M))
            ));
        }
        if let Some((began, _)) = self.span {
            let elapsed_s = now.saturating_sub(began).as_secs_f64();
            let steps: u64 = self.records.values().map(|(record, _)| u64::from(record.length)).sum();
            if played > 0 && elapsed_s > 0.0 {
                let left_s = elapsed_s / played as f64 * (asked - played) as f64;
                parts.push(format!("{} steps/s", format::rate(steps as f64 / elapsed_s)));
                parts.push(format!("{} left", format::duration(Duration::from_secs_f64(left_s))));
            }
        } else {
            parts.push("starting".to_owned());
        }
        parts.join("  |  ")
    }
}

impl Audience for Examiner {
    fn learner(&mut self, now: Duration, event: &LearnerEvent) -> Result<()> {
        match event {
            LearnerEvent::Ready { frames, device, parameters, .. } => {
                // One that was started again begins again.
                self.records.clear();
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
                let twice = self.records.insert((record.kitchen, record.episode), (*record, actions.clone()));
                ensure!(twice.is_none(), "episode {} of kitchen {} was played twice", record.episode, record.kitchen);
            }
            _ => {}
        }
        Ok(())
    }

    fn learner_died(&mut self, _now: Duration) {}

    fn tick(&mut self, now: Duration, _recorder: Option<&Recorder>) {
        if self.live.is_due(now) {
            self.live.show(vec![self.line(now)]);
        }
    }

    fn over(&mut self) {
        self.live.clear();
    }
}
