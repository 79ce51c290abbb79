//! The half of an agent that learns: everything that an update changes or needs besides the rollout. It can be given to
//! another thread for an update.

use super::error::AgentError;
use crate::auxiliary::{Auxiliary, Sizes};
use crate::network::Network;
use crate::optimizer::Adam;
use crate::peers::Peers;
use crate::ppo::running::Running;
use crate::ppo::{Update, UpdateError};
use crate::rollout::Rollout;
use crate::shards::Shards;
use proto::config::Config;
use proto::learning_rate::falling;
use std::collections::BTreeMap;
use tch::Device;

pub(super) const HERE: &str = "no update runs, or it has ended";

#[derive(Debug)]
pub(super) struct Trainer {
    pub network: Network,
    pub auxiliary: Auxiliary,
    pub adam: Adam,
    pub running: Running,
    pub peers: Peers,
    pub shards: Shards,
    /// Number, in the whole run, of this learner's first column.
    pub first_column: usize,
}

#[derive(Debug)]
pub(super) struct Job {
    pub trainer: Box<Trainer>,
    pub collected: Rollout,
    pub number: u64,
    pub learning_rate: f64,
    pub config: Config,
}

#[derive(Debug)]
pub(super) struct Done {
    pub trainer: Box<Trainer>,
    pub collected: Rollout,
    pub result: Result<BTreeMap<String, f64>, AgentError>,
}

/// The configured network with weights drawn from the seed, in the configured precision.
pub(super) fn build(config: &Config, device: Device) -> Result<(Network, Auxiliary), AgentError> {
    let actions = config.policy_actions().len() as i64;
    let (mut network, auxiliary) = Network::new(config, device, |layout, hidden| {
        Auxiliary::new(&config.auxiliary, layout, Sizes { hidden, actions })
    });
    network.choose_precision(config.learner.encoder_precision)?;
    Ok((network, auxiliary))
}

impl Job {
    /// `progress` is how far learning rate, clip range and entropy bonus have fallen.
    pub fn new(trainer: Box<Trainer>, collected: Rollout, number: u64, progress: f64, config: &Config) -> Self {
        let (mut config, shuffle) = (config.clone(), config.shuffle());
        let ppo = &mut config.ppo;
        let learning_rate = falling(ppo.learning_rate, ppo.learning_rate_end, progress);
        ppo.shuffle = shuffle;
        ppo.clip = falling(ppo.clip, ppo.clip_end, progress);
        ppo.entropy_coefficient = falling(ppo.entropy_coefficient, ppo.entropy_coefficient_end, progress);
        Self { trainer, collected, number, learning_rate, config }
    }

    pub fn run(self) -> Done {
        let Self { mut trainer, collected, number, learning_rate, config } = self;
        let Trainer { network, auxiliary, adam, running, peers, shards, first_column } = &mut *trainer;
        let before = running.clone();
        let met = running.take_in_returns(&collected, *first_column, peers);
        let update = Update {
            network,
            auxiliary,
            rollout: &collected,
            ppo: &config.ppo,
            auxiliary_config: &config.auxiliary,
            peers,
            shards,
            reward_scale: running.reward_scale(),
            first_column: *first_column,
            learning_rate,
            seed: config.seed,
            rollout_number: number,
        };
        let result = met.map_err(UpdateError::from).and_then(|()| update.run(adam)).and_then(|figures| {
            running.take_in_observations(&collected, *first_column, network, peers)?;
            Ok(figures)
        });
        let result = result.inspect_err(|_| *running = before);
        let result = result.map_err(|error| match error {
            UpdateError::NonFinite(what) => AgentError::NonFinite { what: format!("rollout {number}: {what}") },
            UpdateError::Peers(error) => error.into(),
        });
        Done { trainer, collected, result }
    }
}
