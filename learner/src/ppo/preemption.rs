//! Straggler pre-emption of DD-PPO (Wijmans et al. 2020): when most learners have finished their rollout, the others
//! end theirs where they are, so that the gradient's mean does not wait for the slowest.
//!
//! Within one learner nobody can straggle: where the rule is in force its actors go in lockstep, and every column ends a
//! rollout in the same step. So the rule is one between learners. What it needs of the others is how many
//! have finished ([`Finished`]), which [`crate::peers::Peers::finished`] counts.
//!
//! When the others finish depends on timing, so a run with pre-emption is not reproducible to the last bit. It is off
//! unless `ppo.preemption_share` is above 0.

use crate::peers::Finished;

/// Share of its steps that a rollout must have before it may be ended early: less is hardly worth an update.
const LEAST_STEPS: f64 = 0.25;

/// Whether a learner that has taken `steps` of `planned` steps ends its rollout now. `share` is that of the learners
/// that must have finished; 0 = never.
pub(crate) fn ends_early(share: f64, [steps, planned]: [usize; 2], others: Finished) -> bool {
    let most_have_finished = f64::from(others.finished) >= share * f64::from(others.learners);
    let worth_an_update = steps as f64 >= LEAST_STEPS * planned as f64;
    share > 0.0 && others.finished > 0 && most_have_finished && worth_an_update && (1..planned).contains(&steps)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn sixty_percent_of_eight_are_five() {
        let early = |finished| ends_early(0.6, [100, 200], Finished { finished, learners: 8 });
        assert_eq!((0..=7).filter(|&finished| early(finished)).collect::<Vec<_>>(), [5, 6, 7]);
    }

    #[test]
    fn a_quarter_of_the_steps_must_be_there() {
        let early = |steps| ends_early(0.6, [steps, 200], Finished { finished: 7, learners: 8 });
        assert!(!early(0) && !early(49) && early(50) && early(199) && !early(200));
        assert!(!ends_early(0.6, [0, 1], Finished { finished: 7, learners: 8 }), "some frame must be there");
    }

    proptest! {
        #[test]
        fn alone_or_switched_off_nobody_is_hurried(
            share in 0.0f64..=1.0, steps in 0usize..300, planned in 1usize..300, learners in 1u32..64,
        ) {
            let early = |share: f64, finished: u32| ends_early(share, [steps, planned], Finished { finished, learners });
            prop_assert!(!early(share, 0));
            prop_assert!(!early(0.0, learners - 1));
        }

        /// Who is hurried at some point is hurried at every later one.
        #[test]
        fn the_rule_is_monotonous(
            share in 0.01f64..=1.0, steps in 0usize..298, planned in 1usize..300, finished in 0u32..63,
        ) {
            let early = |steps: usize, finished: u32| {
                ends_early(share, [steps, planned], Finished { finished, learners: 64 })
            };
            if early(steps, finished) {
                prop_assert!(early(steps, finished + 1));
                prop_assert!(steps + 1 == planned || early(steps + 1, finished));
            }
        }
    }
}
