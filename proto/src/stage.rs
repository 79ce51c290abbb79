//! Stages of a run and the arithmetic of their frame budgets.
//!
//! Pure functions of the configuration and the number of frames trained on: the orchestrator decides with them, and the
//! learner checks the announcement with them.

use crate::config::StageConfig;
use crate::grouped::grouped;
use std::ops::Range;

/// Position of a run in its stages, from the frames trained on so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StagePosition {
    /// Index of the stage in the configuration.
    pub stage: usize,
    /// Frames trained on within this stage.
    pub frames_in_stage: u64,
    /// Remaining frames of this stage; at least 1.
    pub frames_left: u64,
}

pub fn total_frames(stages: &[StageConfig]) -> u64 {
    stages.iter().map(|stage| stage.frames).sum()
}

/// The position after `frames` frames, or `None` when the run is complete.
pub fn position_at(stages: &[StageConfig], frames: u64) -> Option<StagePosition> {
    let mut start = 0;
    for (stage, config) in stages.iter().enumerate() {
        if frames < start + config.frames {
            return Some(StagePosition {
                stage,
                frames_in_stage: frames - start,
                frames_left: start + config.frames - frames,
            });
        }
        start += config.frames;
    }
    None
}

/// How a rollout is cut so that a stage ends exactly on its budget.
///
/// A rollout has at most `rollout_steps` steps of all `environments`. The last one of a stage may be shorter, and its
/// last step may be taken by the first few environments only; the others HOLD.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RolloutShape {
    pub steps: usize,
    pub environments_in_last_step: usize,
    pub frames: u64,
}

impl RolloutShape {
    /// The shape of the next rollout when the stage still wants `frames_left` frames. Panics if an argument is 0.
    pub fn next(frames_left: u64, rollout_steps: usize, environments: usize) -> Self {
        assert!(frames_left > 0 && rollout_steps > 0 && environments > 0, "a rollout has frames");
        let per_step = environments as u64;
        let frames = frames_left.min(rollout_steps as u64 * per_step);
        let steps = frames.div_ceil(per_step);
        Self { steps: steps as usize, environments_in_last_step: (frames - (steps - 1) * per_step) as usize, frames }
    }

    /// The part of a learner that has these of the environments: where none of them acts in the last step, that is a
    /// step shorter; in a rollout of one step, no step at all.
    #[must_use]
    pub fn part(self, environments: Range<usize>) -> Self {
        let width = environments.len();
        let in_last = self.environments_in_last_step.clamp(environments.start, environments.end) - environments.start;
        let (steps, in_last) = if in_last > 0 { (self.steps, in_last) } else { (self.steps - 1, width) };
        match steps {
            0 => Self { steps, environments_in_last_step: 0, frames: 0 },
            _ => Self { steps, environments_in_last_step: in_last, frames: ((steps - 1) * width + in_last) as u64 },
        }
    }
}

/// The stages with their budgets scaled so that they sum to `total` exactly, proportions kept.
///
/// Errors if a stage would get no frame.
pub fn scale_to(stages: &[StageConfig], total: u64) -> Result<Vec<StageConfig>, TooFewFrames> {
    let old_total = u128::from(total_frames(stages)).max(1);
    let mut scaled = stages.to_vec();
    let mut start_old = 0u128;
    let mut start_new = 0u64;
    for stage in &mut scaled {
        start_old += u128::from(stage.frames);
        let end_new = (start_old * u128::from(total) / old_total) as u64;
        stage.frames = end_new - start_new;
        start_new = end_new;
    }
    if scaled.iter().any(|stage| stage.frames == 0) {
        return Err(TooFewFrames { total, stages: stages.len() });
    }
    Ok(scaled)
}

/// The stages of a run that has trained `trained` frames, with new budgets that sum to `total`. Stages that have ended
/// keep theirs, the others share the rest in proportion: before the first stage has ended, that is [`scale_to`]. The
/// last stage never counts as ended, so a complete run continues in it.
///
/// Errors if frames that are trained would lie beyond the end of their stage.
pub fn rebudget(stages: &[StageConfig], trained: u64, total: u64) -> Result<Vec<StageConfig>, BudgetError> {
    if total < trained {
        return Err(BudgetError::Trained { total, trained });
    }
    let last = stages.len().saturating_sub(1);
    let (mut current, mut start) = (0, 0);
    while current < last && start + stages[current].frames <= trained {
        start += stages[current].frames;
        current += 1;
    }
    let (ended, open) = stages.split_at(current);
    let mut result = ended.to_vec();
    let too_few = |_| BudgetError::TooFew { total, left: total - start, stages: open.len() };
    result.extend(scale_to(open, total - start).map_err(too_few)?);
    let (old, new) = (stages[current].frames, result[current].frames);
    let trained_in_stage = trained - start;
    if new < trained_in_stage {
        // The smallest total whose share for this stage, rounded down, is enough.
        let share = u128::from(trained_in_stage) * u128::from(total_frames(open));
        let least = start + share.div_ceil(u128::from(old.max(1))) as u64;
        let stage = stages[current].name.clone();
        return Err(BudgetError::StageTrained { total, stage, end: start + new, trained, least });
    }
    Ok(result)
}

#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum BudgetError {
    #[error(
        "the run has {} frames already, and a budget of {} cannot take them back: give more",
        grouped(*trained), grouped(*total)
    )]
    Trained { total: u64, trained: u64 },
    #[error(
        "with {} frames stage {stage} would end at {}; the run has {} already: give {} or more",
        grouped(*total), grouped(*end), grouped(*trained), grouped(*least)
    )]
    StageTrained { total: u64, stage: String, end: u64, trained: u64, least: u64 },
    #[error(
        "--frames {total} leaves {} frames, too few for the {stages} stages that have not ended: ask for more",
        grouped(*left)
    )]
    TooFew { total: u64, left: u64, stages: usize },
}

#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error("--frames {total} cannot be divided over {stages} stages: ask for more")]
pub struct TooFewFrames {
    pub total: u64,
    pub stages: usize,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shares::Shares;
    use proptest::prelude::*;

    fn two(first: u64, second: u64) -> Vec<StageConfig> {
        vec![
            StageConfig { name: "I".into(), reward: "r".into(), frames: first },
            StageConfig { name: "II".into(), reward: "r_prime".into(), frames: second },
        ]
    }

    #[test]
    fn a_budget_that_is_too_small_says_which_is_enough() {
        let problem = rebudget(&two(16_000, 24_000), 15_808, 20_000).unwrap_err().to_string();
        let expected = "with 20,000 frames stage I would end at 8,000; the run has 15,808 already: give 39,520 or more";
        assert_eq!(problem, expected);
    }

    proptest! {
        #[test]
        fn rollouts_add_up_to_every_stage_exactly(
            first in 1u64..5_000, second in 1u64..5_000, steps in 1usize..40, environments in 1usize..30,
        ) {
            let stages = two(first, second);
            let mut frames = 0;
            let mut ends = vec![];
            while let Some(position) = position_at(&stages, frames) {
                let shape = RolloutShape::next(position.frames_left, steps, environments);
                prop_assert!(shape.steps <= steps && shape.environments_in_last_step <= environments);
                prop_assert_eq!(
                    shape.frames,
                    ((shape.steps - 1) * environments + shape.environments_in_last_step) as u64
                );
                frames += shape.frames;
                if shape.frames == position.frames_left { ends.push(frames); }
            }
            prop_assert_eq!(ends, vec![first, first + second]);
        }

        #[test]
        fn learners_parts_are_the_whole(
            frames_left in 1u64..500, steps in 1usize..20, actors in 1u32..12, learners in 1u32..6, each in 1usize..4,
        ) {
            prop_assume!(learners <= actors);
            let (shares, environments) = (Shares::new(actors, learners), actors as usize * each);
            let whole = RolloutShape::next(frames_left, steps, environments);
            let mut frames = 0;
            for rank in 0..learners {
                let Range { start, end } = shares.actors_of(rank);
                let columns = start as usize * each..end as usize * each;
                let part = whole.part(columns.clone());
                frames += part.frames;
                // Whoever acts in a step of the whole acts in the same step of its part.
                for column in columns.clone() {
                    let acts = |shape: RolloutShape, column: usize, t: usize| {
                        t + 1 < shape.steps || (t + 1 == shape.steps && column < shape.environments_in_last_step)
                    };
                    for t in 0..whole.steps {
                        prop_assert_eq!(acts(whole, column, t), acts(part, column - columns.start, t));
                    }
                }
            }
            prop_assert_eq!(frames, whole.frames);
            prop_assert_eq!(whole.part(0..environments), whole);
        }

        /// What is trained stays where it is, the sum is what was asked for, and the least that an error names is
        /// enough.
        #[test]
        fn a_new_budget_leaves_what_is_trained(
            budgets in prop::collection::vec(100u64..3_000, 1..4), at in any::<prop::sample::Index>(),
            total in 0u64..20_000,
        ) {
            let stage = |&frames: &u64| StageConfig { name: "I".into(), reward: "r".into(), frames };
            let stages: Vec<StageConfig> = budgets.iter().map(stage).collect();
            let trained = at.index(total_frames(&stages) as usize + 1) as u64;
            match rebudget(&stages, trained, total) {
                Ok(new) => {
                    prop_assert_eq!(total_frames(&new), total);
                    let stage = |stages: &[StageConfig]| position_at(stages, trained).map(|position| position.stage);
                    let before = stage(&stages).unwrap_or(stages.len() - 1);
                    prop_assert_eq!(&new[..before], &stages[..before]);
                    // Unless the stage ends with the last trained frame, the run goes on in it.
                    let ends = total_frames(&new[..=before]) == trained;
                    prop_assert!(ends || stage(&new) == Some(before), "{trained} lie in {new:?}");
                    prop_assert!(total_frames(&new[..=before]) >= trained);
                    prop_assert_eq!(rebudget(&stages, trained, total_frames(&stages)).unwrap(), stages);
                }
                Err(BudgetError::Trained { .. }) => prop_assert!(total < trained),
                Err(BudgetError::StageTrained { least, .. }) => {
                    prop_assert!(least > total);
                    let enough = rebudget(&stages, trained, least);
                    prop_assert!(!matches!(enough, Err(BudgetError::StageTrained { .. })), "{least} is not enough");
                    prop_assert!(rebudget(&stages, trained, least - 1).is_err());
                }
                Err(BudgetError::TooFew { .. }) => prop_assert!(total < trained + 3 * 3_000),
            }
        }

        #[test]
        fn scaling_keeps_the_total(first in 1u64..50_000_000, second in 1u64..50_000_000, total in 2u64..100_000_000) {
            if let Ok(scaled) = scale_to(&two(first, second), total) {
                prop_assert_eq!(total_frames(&scaled), total);
            }
        }
    }

    #[test]
    fn a_new_budget_is_shared_by_the_stages_that_have_not_ended() {
        let frames = |trained, total| {
            let new = rebudget(&two(400, 500), trained, total).map_err(|error| error.to_string())?;
            Ok::<_, String>((new[0].frames, new[1].frames))
        };
        assert_eq!(frames(0, 1800), Ok((800, 1000)), "as `up --frames` would have had it");
        assert_eq!(frames(300, 1800), Ok((800, 1000)));
        assert_eq!(frames(400, 1800), Ok((400, 1400)), "stage I has ended");
        assert_eq!(frames(900, 1800), Ok((400, 1400)), "a complete run goes on in its last stage");
        assert_eq!(frames(700, 700), Ok((400, 300)), "it can end where it is");
        let passed = frames(300, 600).unwrap_err();
        assert!(passed.contains("stage I would end at 266;") && passed.contains("675 or more"), "{passed}");
        assert_eq!(frames(300, 675), Ok((300, 375)));
        let none = frames(400, 400).unwrap_err();
        assert!(none.contains("--frames 400 leaves 0 frames, too few for the 1 stages"), "{none}");
        let back = frames(700, 699).unwrap_err();
        assert!(back.contains("has 700 frames already") && back.contains("a budget of 699"), "{back}");
    }

    #[test]
    fn the_papers_curriculum_scales_in_proportion() {
        let scaled = scale_to(&two(20_000_000, 25_000_000), 900).expect("enough frames");
        assert_eq!((scaled[0].frames, scaled[1].frames), (400, 500));
        assert!(scale_to(&two(20_000_000, 25_000_000), 1).is_err());
    }
}
