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

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use proto::stage::RolloutShape;

    fn stages(frames: &[u64]) -> Vec<StageConfig> {
        let stage = |(i, &frames): (usize, &u64)| StageConfig { name: i.to_string(), reward: "r".into(), frames };
        frames.iter().enumerate().map(stage).collect()
    }

    proptest! {
        /// Whatever the budgets, and wherever learners fall back to: every switch is at its stage's first frame, the
        /// run ends on the budget, versions only grow.
        #[test]
        fn switches_are_where_stages_begin(
            budgets in prop::collection::vec(1u64..3_000, 1..4), steps in 1usize..20, environments in 1usize..20,
            rewinds in prop::collection::vec(any::<prop::sample::Index>(), 0..5),
        ) {
            let stages = stages(&budgets);
            let mut machine = StageMachine::new(stages.clone());
            let mut boundaries = vec![0u64];
            let mut rewinds = rewinds.into_iter();
            let mut version = 0;
            let mut stage_in_force = None;
            let mut at = 0usize;
            while let Some(word) = machine.allow(at as u64, boundaries[at]) {
                prop_assert_eq!(word.announcement.version, version + 1);
                version += 1;
                prop_assert_eq!(word.announcement.rollout, at as u64);
                prop_assert_eq!(word.announcement.directive, directive::TRAIN);
                let position = position_at(&stages, boundaries[at]).expect("allowed");
                prop_assert_eq!(word.announcement.stage as usize, position.stage);
                prop_assert_eq!(word.switch.is_some(), stage_in_force != Some(position.stage));
                if let Some(switch) = word.switch {
                    prop_assert_eq!((switch.from, switch.frames), (stage_in_force, boundaries[at]));
                    if stage_in_force.is_some_and(|before| before < switch.to) {
                        prop_assert_eq!(position.frames_in_stage, 0);
                    }
                }
                stage_in_force = Some(position.stage);
                let end = boundaries[at] + RolloutShape::next(position.frames_left, steps, environments).frames;
                boundaries.truncate(at + 1);
                boundaries.push(end);
                at += 1;
                if at % 7 == 3 && let Some(rewind) = rewinds.next() {
                    at = rewind.index(at + 1);
                }
            }
            prop_assert_eq!(boundaries[at], machine.budget());
            let stop = machine.stop();
            prop_assert_eq!((stop.version, stop.directive), (version + 1, directive::STOP));
        }
    }
}
