//! Proximal policy optimisation (Schulman et al. 2017) as DD-PPO runs it (Wijmans et al. 2020): the rollout
//! ([`crate::rollout`]), its advantages ([`gae`]), the loss ([`loss`]), the update ([`update`]).

pub mod gae;
pub mod loss;
pub mod update;
