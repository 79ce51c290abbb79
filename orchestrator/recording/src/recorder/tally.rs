//! Whether the recording holds as many steps as were trained on: pure counting, rollout by rollout.
//!
//! A learner trains on a rollout only after the recorder has confirmed it. So at that moment every step recorded under
//! this learner since the last such moment belongs to the rollout.

#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Tally {
    learner_incarnation: u32,
    /// Frames of the run up to the last rollout that was confirmed, or that this learner began with.
    frames: Option<u64>,
    steps: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "{recorded} of the {collected} steps of rollout {rollout} were recorded. It is not trained on: `orchestrator resume` \
     collects it again"
)]
pub struct Gap {
    pub rollout: u64,
    pub collected: u64,
    pub recorded: u64,
}

impl Tally {
    pub fn begin(&mut self, learner_incarnation: u32, frames: u64) {
        self.follow(learner_incarnation);
        self.frames = Some(frames);
    }

    pub fn record(&mut self, learner_incarnation: u32, steps: u64) {
        self.follow(learner_incarnation);
        // What an actor sent to a learner that was replaced is no part of what is trained on.
        if learner_incarnation == self.learner_incarnation {
            self.steps += steps;
        }
    }

    /// The learners have collected a rollout and have `frames` frames with it, of which `collected` are of this rollout
    /// and this host. An error if their steps are not all recorded.
    pub fn collect(
        &mut self,
        learner_incarnation: u32,
        rollout: u64,
        [collected, frames]: [u64; 2],
    ) -> Result<(), Gap> {
        self.follow(learner_incarnation);
        let recorded = std::mem::take(&mut self.steps);
        if recorded < collected {
            return Err(Gap { rollout, collected, recorded });
        }
        self.frames = Some(frames);
        Ok(())
    }

    pub fn frames(&self) -> Option<u64> {
        self.frames
    }

    fn follow(&mut self, learner_incarnation: u32) {
        if learner_incarnation > self.learner_incarnation {
            *self = Self { learner_incarnation, ..Self::default() };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rollout_is_as_many_steps_as_frames_under_its_own_learner() {
        let mut tally = Tally::default();
        assert_eq!(tally.frames(), None);
        tally.begin(1, 100);
        tally.record(1, 6);
        tally.record(1, 4);
        assert_eq!((tally.collect(1, 7, [10, 110]), tally.frames()), (Ok(()), Some(110)));
        // The learner dies in the middle; its successor's first steps may come before its first word.
        tally.record(1, 5);
        tally.record(2, 3);
        tally.record(1, 5);
        tally.begin(2, 100);
        assert_eq!(tally.frames(), Some(100));
        tally.record(2, 7);
        assert_eq!((tally.collect(2, 7, [10, 110]), tally.frames()), (Ok(()), Some(110)));
        tally.record(2, 9);
        assert_eq!(tally.collect(2, 8, [10, 120]), Err(Gap { rollout: 8, collected: 10, recorded: 9 }));
        assert_eq!(tally.frames(), Some(110), "what is not all there does not count");
        // Of a run on several hosts only what is made here must be here.
        tally.begin(3, 110);
        tally.record(3, 4);
        assert_eq!((tally.collect(3, 8, [4, 120]), tally.frames()), (Ok(()), Some(120)));
    }
}
