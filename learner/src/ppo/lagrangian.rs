//! PPO-Lagrangian (Ray et al., *Benchmarking Safe Exploration in Deep Reinforcement Learning*, 2019), the paper's
//! constrained baseline:
//!
//! ```text
//! max over π, min over λ ≥ 0 of  J(π) − λ·J_C(π),   J_C = E Σ γ^t c_t
//! ```
//! c is the cost that the task declares. PPO trains the policy on r − λ·c. After each update λ takes one step of
//! gradient ascent on the constraint. The constraint allows no cost, so λ rises as long as episodes cost anything, and
//! falls only when `J_C` is negative.

/// λ after an update in which episodes ended with a mean discounted cost `J_C`.
pub(crate) fn ascend(multiplier: f64, learning_rate: f64, discounted_cost: f64) -> f64 {
    (multiplier + learning_rate * discounted_cost).max(0.0)
}
