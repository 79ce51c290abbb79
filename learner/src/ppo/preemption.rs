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

    #[test]
    fn sixty_percent_of_eight_are_five_and_a_quarter_of_the_steps_must_be_there() {
        let early = |share, steps, finished| ends_early(share, [steps, 200], Finished { finished, learners: 8 });
        assert_eq!((0..=7).filter(|&finished| early(0.6, 100, finished)).collect::<Vec<_>>(), [5, 6, 7]);
        assert_eq!([0, 49, 50, 199, 200].map(|steps| early(0.6, steps, 7)), [false, false, true, true, false]);
        assert!(!ends_early(0.6, [0, 1], Finished { finished: 7, learners: 8 }), "some frame must be there");
        assert!(!early(0.0, 100, 7) && !early(0.01, 100, 0), "switched off, or alone");
    }
}
