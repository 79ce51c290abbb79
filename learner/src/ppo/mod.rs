//! Proximal policy optimisation (Schulman et al. 2017) as DD-PPO runs it (Wijmans et al. 2020): the rollout
//! ([`crate::rollout`]), its advantages ([`gae`]), the loss ([`loss`]), the update ([`update`]); the multiplier of the
//! constrained variant ([`lagrangian`]); when a learner does not wait for its own last steps ([`preemption`]).

pub mod gae;
pub mod lagrangian;
pub mod loss;
pub mod preemption;
pub mod update;
