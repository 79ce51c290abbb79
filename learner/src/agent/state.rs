//! What a checkpoint keeps of an agent, and how it comes back.

use super::{Agent, AgentError};
use crate::network::{Unfit, fits};
use crate::rollout::Rollout;
use proto::config::{CarriedGoal, NetworkConfig};
use std::collections::BTreeMap;
use tch::{Device, Tensor};

/// What the names of weights begin with in [`AgentState::tensors`], and so in a checkpoint.
pub const MODEL: &str = "model.";

const FIRST_MOMENT: &str = "adam.first";
const SECOND_MOMENT: &str = "adam.second";
/// What the beliefs are called there.
pub const BELIEFS: &str = "beliefs";

/// Everything of an agent that a checkpoint keeps, on the CPU.
#[derive(Debug)]
pub struct AgentState {
    /// Weights as `model.…` with PyTorch's module paths, Adam's moments as `adam.first` and `adam.second` (flat, in the
    /// network's order), and `beliefs` \[columns, hidden\]. All f32.
    pub tensors: BTreeMap<String, Tensor>,
    /// Optimiser steps taken in this stage.
    pub adam_steps: u64,
    /// PPO-Lagrangian's multiplier.
    pub multiplier: f64,
    /// Sign of the goal vector that the weights were trained with.
    pub carried_goal: CarriedGoal,
}

/// Weights that were trained with the other sign of the goal vector.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "the weights were trained with network.carried_goal = \"{trained}\", the configuration says \"{configured}\": while \
     the target is held they would see their goal in the opposite direction. Set network.carried_goal = \"{trained}\""
)]
pub struct OtherSign {
    /// Of the weights.
    pub trained: CarriedGoal,
    /// Of the configuration.
    pub configured: CarriedGoal,
}

impl OtherSign {
    /// Refuses weights that were trained with another sign than this network's, where it sees one.
    pub fn refuse(trained: CarriedGoal, network: &NetworkConfig) -> Result<(), Self> {
        match network.sign_seen() {
            Some(configured) if configured != trained => Err(Self { trained, configured }),
            _ => Ok(()),
        }
    }
}

/// The weights among a checkpoint's tensors, by the network's own names. Nothing is copied.
pub fn weights_of(tensors: &BTreeMap<String, Tensor>) -> BTreeMap<String, Tensor> {
    let weight =
        |(name, tensor): (&String, &Tensor)| Some((name.strip_prefix(MODEL)?.to_owned(), tensor.shallow_clone()));
    tensors.iter().filter_map(weight).collect()
}

impl Agent {
    /// Everything a checkpoint keeps, as of the last rollout boundary: in the middle of a rollout, the beliefs are those
    /// it started from.
    pub fn state(&self) -> AgentState {
        let host = |tensor: &Tensor| tensor.detach().to_device(Device::Cpu).copy();
        let mut tensors: BTreeMap<String, Tensor> =
            self.network.parameters.named().map(|(name, weight)| (format!("{MODEL}{name}"), host(&weight))).collect();
        tensors.insert(FIRST_MOMENT.into(), host(&self.adam.first));
        tensors.insert(SECOND_MOMENT.into(), host(&self.adam.second));
        tensors.insert(BELIEFS.into(), self.boundary_beliefs());
        AgentState {
            tensors,
            adam_steps: self.adam.steps,
            multiplier: self.multiplier,
            carried_goal: self.config.network.carried_goal,
        }
    }

    /// Beliefs \[columns, hidden\] as of the last rollout boundary, on the CPU.
    pub fn boundary_beliefs(&self) -> Tensor {
        let beliefs = self.rollout.as_ref().map_or(&self.beliefs, Rollout::beliefs_at_start);
        beliefs.detach().to_device(Device::Cpu).copy()
    }

    /// Goes on from a saved state; a rollout in progress is forgotten. After an error nothing has changed.
    pub fn load_state(&mut self, state: &AgentState) -> Result<(), AgentError> {
        let AgentState { tensors, adam_steps, multiplier, carried_goal } = state;
        OtherSign::refuse(*carried_goal, &self.config.network)?;
        let saved = |name: &str, place: &Tensor| fits(name, tensors.get(name), &place.size());
        let first = saved(FIRST_MOMENT, &self.adam.first)?;
        let second = saved(SECOND_MOMENT, &self.adam.second)?;
        let beliefs = saved(BELIEFS, &self.beliefs)?;
        let known = |name: &str| name.starts_with(MODEL) || [FIRST_MOMENT, SECOND_MOMENT, BELIEFS].contains(&name);
        if let Some(name) = tensors.keys().find(|name| !known(name)) {
            return Err(Unfit::no_place(name).into());
        }
        if !multiplier.is_finite() {
            return Err(Unfit::not_finite("multiplier").into());
        }
        self.network.parameters.load(&weights_of(tensors))?;
        // Nothing can fail from here on.
        self.abandon_rollout();
        tch::no_grad(|| {
            self.adam.first.copy_(first);
            self.adam.second.copy_(second);
            self.beliefs.copy_(beliefs);
        });
        self.adam.steps = *adam_steps;
        self.multiplier = *multiplier;
        Ok(())
    }

    /// Takes the weights of another run's state and nothing else. After an error nothing has changed.
    pub fn load_weights(&mut self, state: &AgentState) -> Result<(), AgentError> {
        OtherSign::refuse(state.carried_goal, &self.config.network)?;
        Ok(self.network.parameters.load(&weights_of(&state.tensors))?)
    }
}
