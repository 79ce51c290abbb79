//! Several learners compute what one does that has all the environments.

use crate::world::{self, World, numbers_config, small_config};
use learner::agent::Agent;
use learner::network::to_vec;
use learner::peers::{Meeting, Peers};
use learner::rollout::Outcome;
use proto::config::{AuxiliaryTask, Config, Encoder, Memory, Shuffle};
use proto::metric;
use std::collections::BTreeMap;
use tch::{Device, Tensor};

/// What a learner has after three rollouts.
struct Trained {
    digest: String,
    weights: Tensor,
    figures: Vec<BTreeMap<String, f64>>,
}

/// All weights, one after another.
fn weights_of(agent: &Agent) -> Tensor {
    let weights: Vec<f32> = world::weights_of(agent).values().flat_map(to_vec).collect();
    Tensor::from_slice(&weights)
}

/// Trains with `config.learner.count` learners, threads here, each in its part of the same world.
fn train(config: &Config) -> Vec<Trained> {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let meeting = Meeting::File(folder.path().join("meeting"));
    let learner = |rank: u32| {
        let peers = Peers::join(&meeting, [rank, config.learner.count], Device::Cpu).expect("the others come");
        let (actors, each) = (config.shares().actors_of(rank), config.actors.environments_per_actor);
        let own = (actors.start * each) as usize..(actors.end * each) as usize;
        let mut agent = Agent::among(peers, own.clone(), config, Device::Cpu).expect("a fresh agent");
        if config.ppo.overlap {
            agent.overlap().expect("a thread");
        }
        let mut world = World::of_learner(config, own);
        if config.learner.shards > 0 {
            world = world.in_halves_of_actors(config.actors.environments_per_actor);
        }
        let all = config.environments();
        // All act to the end; in the last step only the first column does, and the last learner is a step short; there
        // is one step, and only the first column takes it.
        let rollouts = [(6, all), (6, 1), (1, 1)];
        let figures = (0..).zip(rollouts).map(|(rollout, (steps, last))| {
            (world.steps, world.planned) = (steps, steps);
            world.collect(&mut agent, rollout, last).expect("finite");
            if !config.ppo.overlap {
                return agent.update(0.1, rollout as u64).expect("finite");
            }
            agent.begin_update(0.1, rollout as u64);
            // The shape of another rollout, so that learners take unlike times for it.
            (world.steps, world.planned) = (6, 6);
            world.collect(&mut agent, 10 + rollout, all).expect("finite");
            let figures = agent.finish_update().expect("finite");
            agent.abandon_rollout();
            figures
        });
        let figures = figures.collect();
        Trained { digest: agent.weights_digest(), weights: weights_of(&agent), figures }
    };
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..config.learner.count).map(|rank| scope.spawn(move || learner(rank))).collect();
        threads.into_iter().map(|thread| thread.join().expect("no panic")).collect()
    })
}

/// Contrastive prediction is left out: its negatives come from the rows of one pass, and those are other rows.
#[test]
fn two_learners_take_the_steps_of_one() {
    for (task, normalized) in
        [(AuxiliaryTask::None, true), (AuxiliaryTask::Disturb, false), (AuxiliaryTask::InverseDynamics, false)]
    {
        let mut config = small_config();
        config.auxiliary.task = task;
        config.ppo.normalize_advantages = normalized;
        let fresh = weights_of(&Agent::new(&config, Device::Cpu).expect("a fresh agent"));
        let alone = train(&config).remove(0);
        config.learner.count = 2;
        let both = train(&config);
        assert_eq!(both[0].digest, both[1].digest, "{task:?}: the same bits at both");
        // Adam makes whole steps also of gradients that are hardly more than rounding, so single weights may differ: by
        // the way that all have come, they hardly do.
        let length = |weights: &Tensor| weights.norm().double_value(&[]);
        let apart = length(&(&both[0].weights - &alone.weights)) / length(&(&alone.weights - &fresh));
        assert!(apart < 1e-3, "{task:?}: {apart} of the way apart");
        assert_eq!(both[0].figures, both[1].figures, "{task:?}: both know the whole batch");
        for (one, two) in alone.figures.iter().zip(&both[0].figures) {
            let mut two = two.clone();
            assert!(two.remove(metric::EXCHANGED).is_some_and(|bytes| bytes > 0.0), "only several exchange anything");
            assert_eq!(one.keys().collect::<Vec<_>>(), two.keys().collect::<Vec<_>>());
            for (name, figure) in one {
                assert!(
                    (two[name] - figure).abs() <= 1e-4 * figure.abs().max(1e-3),
                    "{task:?}: {name}: {two:?} {one:?}"
                );
            }
        }
    }
}

/// What an update of two learners ends with at each, when a number breaks it: a reward of one of them, which its loss
/// shows; or a weight with which the auxiliary task's loss is 0 and its slope infinite, so that only the gradient shows
/// it. Both have the weights of before then, and still make the same calls.
fn broken(by_reward: bool) -> [String; 2] {
    let mut config = small_config();
    (config.learner.count, config.ppo.minibatches, config.auxiliary.focal_gamma) = (2, 2, 0.5);
    let folder = tempfile::tempdir().expect("a temporary folder");
    let meeting = Meeting::File(folder.path().join("meeting"));
    let learner = |rank: u32| {
        let peers = Peers::join(&meeting, [rank, 2], Device::Cpu).expect("the other comes");
        let own = 2 * rank as usize..2 * rank as usize + 2;
        let mut agent = Agent::among(peers, own.clone(), &config, Device::Cpu).expect("a fresh agent");
        let mut world = World::of_learner(&config, own);
        let good = agent.state();
        if !by_reward {
            let state = agent.state();
            let _ = state.tensors["model.auxiliary.disturb.2.bias"].shallow_clone().fill_(-200.0);
            agent.load_state(&state).expect("the state fits");
        }
        let before = agent.weights_digest();
        world.collect(&mut agent, 0, 4).expect("finite");
        if by_reward && rank == 1 {
            agent.record(3, 1, Outcome { reward: f32::NAN, ..Outcome::default() });
        }
        let error = agent.update(0.0, 0).expect_err("a number is not finite").to_string();
        assert_eq!((agent.weights_digest(), agent.state().adam_steps), (before.clone(), 0));
        agent.abandon_rollout();
        agent.load_state(&good).expect("the state fits");
        world.collect(&mut agent, 1, 4).expect("finite");
        agent.update(0.0, 1).expect("finite");
        (error, agent.weights_digest())
    };
    let [first, second] = std::thread::scope(|scope| {
        [0, 1].map(|rank| scope.spawn(move || learner(rank))).map(|thread| thread.join().expect("no panic"))
    });
    assert_eq!(first.1, second.1, "the same weights after the next update");
    [first.0, second.0]
}

#[test]
fn a_number_that_is_not_finite_is_named_alike_by_all_learners() {
    for (by_reward, name) in [(true, "rollout 0: loss/"), (false, "rollout 0: gradient of ")] {
        let [first, second] = broken(by_reward);
        assert_eq!(first, second);
        assert!(first.contains(name), "{first}");
    }
}

#[test]
fn the_same_seed_gives_the_same_bits() {
    let mut config = small_config();
    config.learner.count = 2;
    config.auxiliary.task = AuxiliaryTask::Cpca16;
    let mut digests = vec![];
    // With minibatches: in the last rollout only one column acts, so no learner has a row of the others.
    for (overlap, minibatches) in [(false, 1), (true, 1), (false, 2), (true, 3)] {
        (config.ppo.overlap, config.ppo.minibatches) = (overlap, minibatches);
        let [first, again] = [(); 2].map(|()| train(&config));
        assert_eq!(first[0].digest, first[1].digest, "overlap: {overlap}, minibatches: {minibatches}");
        assert_eq!(first[0].digest, again[1].digest, "overlap: {overlap}, minibatches: {minibatches}");
        digests.push(first[0].digest.clone());
    }
    assert_ne!(digests[0], digests[2], "minibatches are steps of their own");
}

/// Shards are inferred and trained on by themselves and added in a fixed order: the same bits whatever the number of
/// learners. Chunks of three columns in shards of four; of five actors the first shard has two.
fn train_with_any_number(change: impl Fn(&mut Config)) -> String {
    train_with(&[4], change)
}

fn train_with(numbers: &[u32], change: impl Fn(&mut Config)) -> String {
    let mut config = small_config();
    (config.actors.count, config.actors.environments_per_actor, config.learner.shards) = (4, 4, 4);
    config.auxiliary.task = AuxiliaryTask::None;
    change(&mut config);
    config.validate().expect("a run can have this");
    let alone = train(&config).remove(0);
    for &learners in numbers {
        config.learner.count = learners;
        for mut other in train(&config) {
            assert_eq!(other.digest, alone.digest, "{learners} learners");
            for figures in &mut other.figures {
                assert!(figures.remove(metric::EXCHANGED).is_some_and(|bytes| bytes > 0.0));
            }
            assert_eq!(other.figures, alone.figures, "{learners} learners");
        }
    }
    alone.digest
}

#[test]
fn with_shards_any_number_of_learners_trains_the_same_weights() {
    let plain = train_with(&[2, 4], |_| ());
    let mut config = small_config();
    (config.actors.count, config.actors.environments_per_actor) = (4, 4);
    config.auxiliary.task = AuxiliaryTask::None;
    assert_ne!(train(&config)[0].digest, plain, "sums of one learner have another order");
}

#[test]
fn with_shards_all_kinds_of_updates_are_the_same() {
    let changes: [fn(&mut Config); 5] = [
        // On a CPU a batch of one observation gives other last bits than that observation among others, with this encoder.
        |config| (config.actors.environments_per_actor, config.network.encoder) = (2, Encoder::Resnet),
        |config| config.ppo.minibatches = 3,
        // Fewer columns in a shard than minibatches.
        |config| (config.actors.environments_per_actor, config.ppo.minibatches) = (1, 3),
        |config| (config.auxiliary.task, config.auxiliary.subsample) = (AuxiliaryTask::InverseDynamics, 0.5),
        |config| (config.ppo.overlap, config.auxiliary.task) = (true, AuxiliaryTask::Disturb),
    ];
    for change in changes {
        train_with_any_number(change);
    }
}

/// Minibatches of frames, running statistics, and episodes that are bootstrapped where they were truncated.
#[test]
fn with_shards_numbers_are_trained_on_alike() {
    for minibatches in [1, 3] {
        train_with_any_number(|config| {
            let (actors, shards) = (config.actors, config.learner.shards);
            *config = numbers_config(Memory::None);
            (config.actors, config.learner.shards) = (actors, shards);
            (config.ppo.minibatches, config.ppo.shuffle, config.ppo.bootstrap_time_limits) =
                (minibatches, Shuffle::Rows, true);
            (config.normalize.observations, config.normalize.rewards) = (true, true);
            config.ppo.normalize_by_minibatch = minibatches > 1;
        });
    }
}

/// Without frames, and with epochs left out by what all learners agree on.
#[test]
fn with_shards_numbers_alone_train_the_same_weights() {
    for memory in [Memory::None, Memory::Gru, Memory::Lstm] {
        let of = |target_kl: f64| {
            train_with_any_number(|config| {
                let shards = Config { actors: config.actors, learner: config.learner, ..numbers_config(memory) };
                *config = shards;
                (config.ppo.epochs, config.ppo.minibatches, config.ppo.target_kl) = (3, 2, target_kl);
            })
        };
        let all_epochs = of(0.0);
        assert_ne!(all_epochs, of(1e-9), "{memory:?}: one epoch is another update");
        assert_eq!(all_epochs, of(1e9), "{memory:?}");
    }
}

#[test]
fn shards_may_differ_in_size_and_passes_may_have_all_of_one() {
    for environments_per_pass in [0, 1, 6] {
        train_with_any_number(|config| {
            (config.actors.count, config.actors.environments_per_actor) = (5, 3);
            (config.ppo.environments_per_pass, config.ppo.minibatches) = (environments_per_pass, 2);
            (config.auxiliary.task, config.ppo.normalize_advantages) = (AuxiliaryTask::Cpca16, true);
        });
    }
}
