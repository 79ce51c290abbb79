//! The half of an agent that learns: everything that an update changes or needs besides the rollout. It can be given to
//! another thread for an update.

use super::error::AgentError;
use crate::auxiliary::{Auxiliary, Sizes};
use crate::network::Network;
use crate::optimizer::Adam;
use crate::peers::Peers;
use crate::ppo::running::Running;
use crate::ppo::{PassGraphs, Update, UpdateError};
use crate::rollout::Rollout;
use crate::shards::Shards;
use proto::config::Config;
use proto::learning_rate::falling;
use std::cell::RefCell;
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
    /// Passes on a GPU, where they can be recorded.
    pub graphs: Option<RefCell<PassGraphs>>,
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
        let Trainer { network, auxiliary, adam, running, peers, shards, first_column, graphs } = &mut *trainer;
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
            graphs: graphs.as_ref(),
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

#[cfg(test)]
mod tests {
    use crate::agent::Agent;
    use crate::bench::Frames;
    use crate::rollout::Outcome;
    use proto::config::{Config, Shuffle};
    use proto::stage::RolloutShape;
    use proto::task::Spec;
    use tch::Device;

    const STEPS: usize = 6;

    /// A rollout of as many frames as are left, and its update.
    fn train(agent: &mut Agent, frames: &Frames, (number, left): (u64, u64), options: usize) {
        let columns = agent.columns().len();
        let shape = RolloutShape::next(left, STEPS, columns);
        agent.begin_rollout(shape);
        for (t, half) in (0..=shape.steps).flat_map(|t| [(t, 0), (t, 1)]) {
            let mut batch = frames.batch(half, t, frames.noise(half, t));
            batch.masks = (0..options * batch.columns.len()).map(|at| at % options != t % 2).collect();
            agent.step(t, &batch.input()).unwrap();
        }
        for (t, column) in (0..shape.steps).flat_map(|t| (0..columns).map(move |column| (t, column))) {
            if t + 1 < shape.steps || column < shape.environments_in_last_step {
                let (reward, ended) = ((t * 31 + column * 17 + number as usize) as f32 % 1.3, Frames::ends(column, t));
                agent.record(t, column, Outcome { reward, ended, ..Outcome::default() });
            }
        }
        let progress = number as f64 / 10.0;
        assert!(agent.update(progress, number).unwrap().values().all(|figure| figure.is_finite()));
    }

    /// To the last bit, whatever falls from update to update, and in a rollout that is cut; whole steps, and passes alone.
    #[test]
    #[ignore = "needs a CUDA device"]
    fn weights_after_recorded_passes_are_those_after_passes_launch_by_launch() {
        let _alone = crate::device::cuda_alone();
        let images = include_str!("../../tests/support/images.toml");
        let discrete = "kind = \"discrete\"\nnames = [\"left\", \"stay\", \"right\"]";
        let masked = "kind = \"multi_discrete\"\ncounts = [2, 3]\n\n[[channels]]\nname = \"action_mask\"\n\
            role = \"mask\"\ndtype = \"u8\"\nshape = [5]\ndoc = \"\"";
        let numbers = "kind = \"box\"\nbounds = [[-1, 1], [0, 2]]";
        for (name, actions) in [("discrete", discrete), ("masked", masked), ("numbers", numbers)] {
            let named = images.replacen("\"images\"", &format!("\"trained_{name}\""), 1);
            Spec::declare(&named.replacen(discrete, actions, 1)).unwrap();
            let settings = format!("task = \"trained_{name}\"\nnetwork.memory = \"none\"\nppo.clip_end = 0.1\n");
            let mut config = Config::resolve_with("gym", Some((&settings, "a test"))).unwrap();
            (config.actors.count, config.actors.environments_per_actor) = (3, 4);
            (config.ppo.minibatches, config.ppo.rollout_steps) = (2, STEPS as u32);
            let options = config.spec().mask().map_or(0, |_| config.action_head().outputs());
            let frames = Frames::new(&config).unwrap();
            for (shuffle, each) in [(Shuffle::Rows, 0), (Shuffle::Environments, 0), (Shuffle::Environments, 3)] {
                (config.ppo.shuffle, config.ppo.environments_per_pass) = (shuffle, each);
                let mut agents = [(); 2].map(|()| Agent::new(&config, Device::Cuda(0)).unwrap());
                agents[1].trainer_mut().graphs = None;
                let before = agents[0].weights_digest();
                for agent in &mut agents {
                    for update in (0..4).map(|number| (number, if number == 2 { 50 } else { 72 })) {
                        train(agent, &frames, update, options);
                    }
                }
                let [recorded, plain] = &agents;
                let graphs = recorded.trainer().graphs.as_ref().unwrap().borrow();
                // A minibatch of six environments is one pass, or two.
                let expected = if each == 0 { [false, true] } else { [true, false] };
                assert_eq!(graphs.have_launched(), expected, "{name} by {shuffle:?}");
                assert_ne!(recorded.weights_digest(), before);
                assert_eq!(recorded.weights_digest(), plain.weights_digest(), "{name} by {shuffle:?}");
            }
        }
    }
}
