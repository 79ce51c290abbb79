//! The stage machine: which rollout the learners may begin, and in which stage. Pure.
//!
//! A learner begins rollout k only when it has been announced. The announcement of k + 1 is made when k is collected,
//! because from then on it is certain how many frames k + 1 starts from; the stage that holds those frames is in force
//! for the whole of k + 1 ([`proto::stage::RolloutShape`] never lets a rollout cross a stage's end). So a switch is
//! always at a rollout boundary, and every learner gets the same announcement.

use proto::config::StageConfig;
use proto::stage::{position_at, total_frames};
use wire::message::{StageAnnouncement, directive};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StageSwitch {
    pub from: Option<usize>,
    pub to: usize,
    pub frames: u64,
    pub rollout: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Decision {
    pub announcement: StageAnnouncement,
    pub switch: Option<StageSwitch>,
}

#[derive(Debug, Clone)]
pub struct StageMachine {
    stages: Vec<StageConfig>,
    version: u64,
    in_force: Option<usize>,
    last: StageAnnouncement,
}

impl StageMachine {
    pub fn new(stages: Vec<StageConfig>) -> Self {
        Self { stages, version: 0, in_force: None, last: StageAnnouncement::default() }
    }

    pub fn budget(&self) -> u64 {
        total_frames(&self.stages)
    }

    /// Allows rollout `rollout`, which begins at `frames` frames. None when the budget is used up.
    pub fn allow(&mut self, rollout: u64, frames: u64) -> Option<Decision> {
        let position = position_at(&self.stages, frames)?;
        let from = self.in_force.replace(position.stage);
        let switch =
            (from != Some(position.stage)).then_some(StageSwitch { from, to: position.stage, frames, rollout });
        Some(Decision { announcement: self.say(rollout, position.stage as u32, directive::TRAIN), switch })
    }

    pub fn next_rollout(&self) -> u64 {
        if self.version == 0 { 0 } else { self.last.rollout + 1 }
    }

    pub fn stop(&mut self) -> StageAnnouncement {
        self.say(self.last.rollout, self.last.stage, directive::STOP)
    }

    /// Takes a stop back: whoever starts now hears what was in force before it.
    pub fn go_on(&mut self) -> StageAnnouncement {
        self.say(self.last.rollout, self.last.stage, directive::TRAIN)
    }

    fn say(&mut self, rollout: u64, stage: u32, directive: u32) -> StageAnnouncement {
        self.version += 1;
        self.last = StageAnnouncement { version: self.version, rollout, stage, directive };
        self.last
    }
}
