//! What a world is made of: the run's configuration, the processes' number, what is wrong on purpose.

use crate::dice::Dice;
use learner::collector::Pace;
use proto::config::{Config, StageConfig};

/// Something that is wrong on purpose, to see that the world finds it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mutation {
    /// Nobody waits for the recorder: an action is the receipt for an observation, as it was until the world had shown
    /// what follows from that.
    IgnoresReceipts,
    /// The recorder gives receipts for steps of which it writes all but one in fifty.
    LosesSteps,
    /// The recorder calls a rollout written that it has only in its memory.
    WritesLater,
    /// The learner sends some actions a second time, with their own number and with that of the next exchange. The
    /// protocol forgives it: this is the one that must not be found.
    AnswersTwice,
    /// An actor takes some actions twice.
    ActsTwice,
    /// An actor that asks for its state is not answered.
    ForgetsRestores,
    /// The learner trains again on the rollout that its checkpoint ends with.
    TrainsTwice,
    /// A checkpoint loses the weights that act while others are trained: the newest act in their place.
    ForgetsPolicies,
    /// The disk does not synchronise what is in files.
    ForgetsFiles,
    /// The disk does not synchronise names.
    ForgetsNames,
    /// An announcement reaches only learners that listened when it was made, and a stop never comes.
    ForgetsHistory,
    /// Ports of the dead are never swept.
    NeverSweeps,
    /// A restored actor takes up the episode one action too early.
    RestoresTooEarly,
}

/// A world's run.
#[derive(Debug, Clone)]
pub struct Setup {
    pub config: Config,
    /// Who acts together, in rollouts with even and with odd numbers.
    pub paces: [Pace; 2],
    /// What is wrong on purpose.
    pub mutation: Option<Mutation>,
}

/// Step limit of an episode: short, so that many end.
pub const MAX_STEPS: u32 = 7;
pub const ACTIONS: u64 = 21;
/// Draws of noise for an action: one is enough for a policy that is a hash.
pub const NOISE: usize = 1;

impl Setup {
    /// The run of a seed: one to three learners, a few actors each, up to four environments, two stages. Every third one
    /// collects rollouts beside updates; in half of all those act who are ready, as on a GPU.
    pub fn of(dice: &mut Dice, seed: u64) -> Self {
        let learners = dice.below(3) + 1;
        let actors = learners + dice.below(3);
        let mut config = Config { seed, preset: "world".into(), ..Config::default() };
        config.actors.count = actors;
        config.actors.environments_per_actor = dice.below(4) + 1;
        config.learner.count = learners;
        config.learner.actor_deadline_s = 60.0;
        config.ppo.rollout_steps = dice.below(5) + 2;
        config.ppo.overlap = seed % 3 == 2;
        config.episode.max_steps = MAX_STEPS;
        config.checkpoint.interval_s = f64::from(dice.one_of(&[0.0_f32, 0.5, 2.0, 300.0]));
        config.checkpoint.keep = dice.below(2) + 2;
        let environments = config.environments() as u64;
        let stage = |name: &str, reward: &str, frames| StageConfig { name: name.into(), reward: reward.into(), frames };
        config.stages = vec![
            stage("I", "r", dice.between(1, 14 * environments)),
            stage("II", "r_prime", dice.between(1, 16 * environments)),
        ];
        let pace = |number: u64| if number.is_multiple_of(2) { Pace::Lockstep } else { Pace::Ready };
        let paces = [pace(seed / 3), pace(seed / 6)];
        Self { config, paces, mutation: None }
    }

    /// Whether this is wrong on purpose.
    pub fn has(&self, mutation: Mutation) -> bool {
        self.mutation == Some(mutation)
    }
}
