//! What a checkpoint keeps of an agent.

use proto::config::CarriedGoal;
use std::collections::BTreeMap;
use tch::Tensor;

/// What the names of weights begin with in [`AgentState::tensors`], and so in a checkpoint.
pub(crate) const MODEL: &str = "model.";

/// What the names of weights begin with that act while others are trained (`ppo.overlap`).
pub(crate) const ACTING: &str = "acting.";
/// Adam's mean of the gradient there.
pub(crate) const FIRST_MOMENT: &str = "adam.first";
/// Adam's mean of its square there.
pub(crate) const SECOND_MOMENT: &str = "adam.second";
pub(crate) const BELIEFS: &str = "beliefs";

#[derive(Debug)]
pub struct AgentState {
    /// Weights as `model.…` with PyTorch's module paths, Adam's moments as `adam.first` and `adam.second` (flat, in the
    /// network's order), and `beliefs` \[columns, state\], all f32; running statistics as `statistics.…`, f64. With
    /// `ppo.overlap` also the weights that the next rollout is collected with, as `acting.…`.
    pub tensors: BTreeMap<String, Tensor>,
    /// Optimiser steps taken in this stage.
    pub adam_steps: u64,
    pub multiplier: f64,
    /// Sign of the goal vector that the weights were trained with.
    pub carried_goal: CarriedGoal,
}

/// The weights among a checkpoint's tensors whose names begin like this, by the network's own names. Nothing is copied.
pub(crate) fn weights_of(tensors: &BTreeMap<String, Tensor>, prefix: &str) -> BTreeMap<String, Tensor> {
    let weight =
        |(name, tensor): (&String, &Tensor)| Some((name.strip_prefix(prefix)?.to_owned(), tensor.shallow_clone()));
    tensors.iter().filter_map(weight).collect()
}
