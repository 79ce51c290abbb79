//! Proximal policy optimisation (Schulman et al. 2017) as DD-PPO runs it (Wijmans et al. 2020): the rollout
//! ([`crate::rollout`]), its advantages ([`gae`]), the loss ([`loss`]), the update ([`update`]); and the multiplier of
//! the constrained variant ([`lagrangian`]).

pub mod gae;
pub mod lagrangian;
pub mod loss;
pub mod update;
