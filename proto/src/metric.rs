//! Names of the figures that a learner reports of an update ([`crate::event::LearnerEvent::RolloutTrained`]). Episode
//! figures are means over the episodes that ended in the rollout and are absent when none did.

/// Episodes that ended in this rollout.
pub const EPISODES: &str = "episode/count";
/// Undiscounted return under the stage's reward.
pub const RETURN: &str = "episode/return";
pub const LENGTH: &str = "episode/length";
/// Σ `γ^t` cost of an episode: what PPO-Lagrangian constrains.
pub const DISCOUNTED_COST: &str = "episode/discounted_cost";
/// Learners that ended this rollout early, because most others had finished (DD-PPO); absent with one learner, or
/// without pre-emption.
pub const PREEMPTED: &str = "rollout/preempted_learners";
/// Bytes of gradients that each learner gave to the sums of this update; absent with one learner.
pub const EXCHANGED: &str = "rollout/exchanged_bytes";
/// Mean reward a step over the rollout.
pub const REWARD: &str = "rollout/reward";
pub const POLICY_LOSS: &str = "loss/policy";
/// Value loss (before its coefficient).
pub const VALUE_LOSS: &str = "loss/value";
/// Policy entropy, nats.
pub const ENTROPY: &str = "policy/entropy";
/// Share of samples whose ratio was clipped.
pub const CLIP_FRACTION: &str = "policy/clip_fraction";
/// Mean of (ratio - 1) - ln(ratio).
pub const APPROXIMATE_KL: &str = "policy/approximate_kl";
/// Global gradient norm before clipping, mean over epochs.
pub const GRADIENT_NORM: &str = "optimizer/gradient_norm";
pub const LEARNING_RATE: &str = "optimizer/learning_rate";
/// PPO-Lagrangian's multiplier after the update; only in its stages.
pub const MULTIPLIER: &str = "lagrangian/multiplier";
/// Auxiliary loss (before its weight); `auxiliary/…` holds the task's other figures.
pub const AUXILIARY_LOSS: &str = "loss/auxiliary";

/// A metric that the task declares: its mean over the episodes that ended.
pub fn of_episode(metric: &str) -> String {
    format!("{EPISODE}{metric}")
}

/// The metric of a task whose figure this is; none of another one.
pub fn of_task(figure: &str) -> Option<&str> {
    figure.strip_prefix(EPISODE).filter(|_| !ALL.contains(&figure))
}

const EPISODE: &str = "episode/";

pub const ALL: [&str; 16] = [
    EPISODES,
    RETURN,
    LENGTH,
    DISCOUNTED_COST,
    PREEMPTED,
    EXCHANGED,
    REWARD,
    POLICY_LOSS,
    VALUE_LOSS,
    ENTROPY,
    CLIP_FRACTION,
    APPROXIMATE_KL,
    GRADIENT_NORM,
    LEARNING_RATE,
    MULTIPLIER,
    AUXILIARY_LOSS,
];
