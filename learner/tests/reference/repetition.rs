//! What must be the same again: the same calls, saved states, other divisions of the batch.

use crate::shared::{assert_close, depth_mm, doubles};
use crate::world::{World, small_config};
use learner::agent::{Agent, AgentError, AgentState, StepInput};
use learner::network::to_vec;
use learner::rollout::Outcome;
use proto::config::{CarriedGoal, Config};
use proto::stage::RolloutShape;
use tch::{Device, Tensor};

fn train(agent: &mut Agent, world: &mut World, rollouts: std::ops::Range<usize>) {
    for rollout in rollouts {
        world.collect(agent, rollout, if rollout == 1 { 2 } else { 4 }).expect("finite");
        agent.update(0.1 * rollout as f64, rollout as u64).expect("finite");
    }
}

/// Three rollouts; or two, and a state that an agent of this seed loads for the third: the same. That agent and its world.
pub fn saved_and_loaded(config: &Config, seed: u64, overlap: bool) -> (Agent, World) {
    let fresh = |seed: u64| {
        let mut agent = Agent::new(&Config { seed, ..config.clone() }, Device::Cpu).expect("a fresh agent");
        if overlap {
            agent.overlap().expect("a thread");
        }
        agent
    };
    let (mut straight, mut world) = (fresh(config.seed), World::new(config));
    train(&mut straight, &mut world, 0..3);
    let (mut first, mut world) = (fresh(config.seed), World::new(config));
    train(&mut first, &mut world, 0..2);
    let mut second = fresh(seed);
    second.load_state(&first.state()).expect("the state fits");
    train(&mut second, &mut world, 2..3);
    assert_eq!(second.weights_digest(), straight.weights_digest(), "{:?}", config.network.memory);
    for (name, tensor) in straight.state().tensors.iter().filter(|(name, _)| name.starts_with("statistics.")) {
        assert_eq!(doubles(tensor), doubles(&second.state().tensors[name]), "{name}");
    }
    (second, world)
}

#[test]
fn the_same_calls_give_the_same_bits_also_through_a_saved_state() {
    let config = small_config();
    let (loaded, _) = saved_and_loaded(&config, 99, false);
    assert_eq!(loaded.state().adam_steps, 6);
    let mut agent = Agent::new(&config, Device::Cpu).expect("a fresh agent");
    let mut world = World::new(&config);
    train(&mut agent, &mut world, 0..2);
    let (state, previous) = (agent.state(), world.previous.clone());
    // A state taken in the middle of a rollout is that of its beginning, and so is one after abandoning it.
    world.collect(&mut agent, 2, 4).expect("finite");
    for (name, tensor) in &agent.state().tensors {
        assert_eq!(to_vec(tensor), to_vec(&state.tensors[name]), "{name}");
    }
    agent.abandon_rollout();
    for _ in 0..2 {
        world.previous.clone_from(&previous);
        train(&mut agent, &mut world, 2..3);
        assert_eq!(agent.weights_digest(), loaded.weights_digest());
        // The second time into an agent that has seen other things.
        agent.load_state(&state).expect("the state fits");
    }
}

#[test]
fn a_rollout_cut_short_trains_as_a_short_one() {
    let mut config = small_config();
    config.ppo.preemption_share = 0.6;
    let digest = |planned: usize| {
        let mut agent = Agent::new(&config, Device::Cpu).expect("a fresh agent");
        assert!(!agent.is_preempted(0, 4, 6).unwrap(), "alone, nobody waits");
        let mut world = World::new(&config);
        (world.steps, world.planned) = (4, planned);
        for rollout in 0..2 {
            world.collect(&mut agent, rollout, 4).expect("finite");
            agent.update(0.1, rollout as u64).expect("finite");
        }
        agent.weights_digest()
    };
    assert_eq!(digest(6), digest(4));
}

#[test]
fn a_fresh_optimiser_matters_and_weights_stay() {
    let config = small_config();
    let mut agent = Agent::new(&config, Device::Cpu).expect("a fresh agent");
    train(&mut agent, &mut World::new(&config), 0..1);
    let digest = agent.weights_digest();
    agent.start_stage();
    let state = agent.state();
    assert_eq!((agent.weights_digest(), state.adam_steps), (digest, 0));
    assert!(to_vec(&state.tensors["adam.second"]).iter().all(|&value| value == 0.0));
}

#[test]
fn a_number_that_is_not_finite_leaves_everything_as_it_was() {
    let config = small_config();
    let mut agent = Agent::new(&config, Device::Cpu).expect("a fresh agent");
    train(&mut agent, &mut World::new(&config), 0..1);
    let before = agent.state();
    let digest = agent.weights_digest();

    let mut world = World::new(&config);
    world.collect(&mut agent, 1, 4).expect("finite");
    agent.record(3, 1, Outcome { reward: f32::NAN, ..Outcome::default() });
    let error = agent.update(0.0, 1).expect_err("a reward is not a number");
    assert!(matches!(&error, AgentError::NonFinite { what } if what.contains("rollout 1: loss/")), "{error}");
    assert_eq!(agent.weights_digest(), digest);
    let after = agent.state();
    assert_eq!(after.adam_steps, before.adam_steps);
    for (name, tensor) in &before.tensors {
        assert_eq!(to_vec(tensor), to_vec(&after.tensors[name]), "{name}");
    }

    // What the update was made of is still there: pooling keeps a frame's mean.
    let rollout = agent.rollout_tensors();
    let mean = |depths_mm: &[f64]| depths_mm.iter().sum::<f64>() / depths_mm.len() as f64;
    let steps = config.ppo.rollout_steps as usize;
    let frames = &rollout["rollout.frames"];
    for (t, column) in [(0, 0), (3, 1), (steps - 1, 3)] {
        let seen: Vec<f64> = depth_mm(steps + t, column).iter().map(|&depth_mm| f64::from(depth_mm)).collect();
        let kept = doubles(&frames.get(t as i64).get(column as i64).flatten(0, -1));
        assert!((mean(&seen) - mean(&kept)).abs() < 0.01, "step {t}, column {column}");
    }
    let poisoned: Vec<bool> = to_vec(&rollout["rollout.reward"]).iter().map(|reward| reward.is_nan()).collect();
    assert_eq!(poisoned.iter().position(|&nan| nan), Some(3 * 4 + 1));
    assert_eq!(poisoned.iter().filter(|&&nan| nan).count(), 1);

    // An observation.
    agent.abandon_rollout();
    assert!(agent.rollout_tensors().is_empty());
    agent.begin_rollout(RolloutShape { steps: 1, environments_in_last_step: 4, frames: 4 });
    let error = world.see(&mut agent, 0, &[2], |agent, input| {
        let numbers = [0.0, f32::INFINITY, 0.0];
        agent.step(0, &StepInput { numbers: &numbers, gumbel: &[0.0; 13], ..*input })
    });
    let error = error.expect_err("a goal is infinite");
    assert!(error.to_string().contains("column 2: an observation"), "{error}");
}

#[test]
fn states_that_do_not_fit_are_refused() {
    let config = small_config();
    let mut agent = Agent::new(&config, Device::Cpu).expect("a fresh agent");
    let before = agent.state();
    let mut refuse = |change: &dyn Fn(&mut AgentState), word: &str| {
        let mut state = agent.state();
        for tensor in state.tensors.values_mut() {
            *tensor = &*tensor + 1.0;
        }
        change(&mut state);
        let error = agent.load_state(&state).expect_err(word).to_string();
        assert!(error.contains(word), "{error}");
        let after = agent.state();
        assert_eq!((after.adam_steps, after.multiplier), (before.adam_steps, before.multiplier));
        for (name, tensor) in &before.tensors {
            assert!(tensor.equal(&after.tensors[name]), "{name} has changed: {error}");
        }
    };
    let remove = |state: &mut AgentState| drop(state.tensors.remove("model.critic.bias"));
    refuse(&remove, "`critic.bias` is missing");
    let reshape = |state: &mut AgentState| {
        let beliefs = state.tensors["beliefs"].narrow(0, 0, 3);
        state.tensors.insert("beliefs".into(), beliefs);
    };
    refuse(&reshape, "`beliefs` is Float [3, 32]");
    let add = |state: &mut AgentState| drop(state.tensors.insert("model.x".into(), Tensor::from_slice(&[1f32])));
    refuse(&add, "`x` has no place");
    refuse(
        &|state| drop(state.tensors.insert("moments".into(), Tensor::from_slice(&[1f32]))),
        "`moments` has no place",
    );
    // What lies last in each was found after everything before it had been copied, or never.
    for name in ["model.critic.bias", "model.auxiliary.disturb.2.bias", "adam.first", "adam.second", "beliefs"] {
        for bad in [f64::NAN, f64::INFINITY] {
            let poison = |state: &mut AgentState| {
                let _ = state.tensors[name].view(-1).get(-1).fill_(bad);
            };
            refuse(&poison, &format!("`{}` is not finite", name.trim_start_matches("model.")));
        }
    }
    refuse(&|state| state.multiplier = f64::NAN, "`multiplier` is not finite");

    refuse(
        &|state| state.carried_goal = CarriedGoal::ObjectToGoal,
        "trained with network.carried_goal = \"object_to_goal\"",
    );

    // The weights alone.
    let mut state = agent.state();
    for tensor in state.tensors.values_mut() {
        *tensor = &*tensor + 1.0;
    }
    let other = AgentState { tensors: agent.state().tensors, carried_goal: CarriedGoal::ObjectToGoal, ..agent.state() };
    assert!(matches!(agent.load_weights(&other), Err(AgentError::Sign(_))));
    let _ = state.tensors["model.critic.weight"].get(0).get(3).fill_(f64::NAN);
    let error = agent.load_weights(&state).expect_err("a weight is no number").to_string();
    assert!(error.contains("`critic.weight` is not finite"), "{error}");
    assert!(before.tensors.iter().all(|(name, tensor)| tensor.equal(&agent.state().tensors[name])));
}

/// Minibatches are steps of their own, by columns that are dealt out anew for each rollout, and chunks divide each.
#[test]
fn each_minibatch_is_a_step_of_the_optimiser() {
    let train_with = |minibatches: u32, environments_per_pass: u32, rollout: u64| {
        let mut config = small_config();
        (config.ppo.minibatches, config.ppo.environments_per_pass, config.ppo.epochs) =
            (minibatches, environments_per_pass, 2);
        let mut agent = Agent::new(&config, Device::Cpu).expect("a fresh agent");
        World::new(&config).collect(&mut agent, 0, 3).expect("finite");
        let metrics = agent.update(0.0, rollout).expect("finite");
        let mut state = agent.state();
        (metrics, state.adam_steps, state.tensors.remove("adam.first").expect("it is there"))
    };
    let (_, one_steps, one) = train_with(1, 0, 0);
    assert_eq!(one_steps, 2);
    let (metrics, steps, two) = train_with(2, 0, 0);
    assert_eq!(steps, 4, "two epochs of two minibatches");
    assert!(!two.equal(&one));
    assert!(train_with(2, 0, 0).2.equal(&two), "the same again");
    assert!(!train_with(2, 0, 1).2.equal(&two), "another rollout's columns are dealt otherwise");
    let (chunked_metrics, _, chunked) = train_with(2, 1, 0);
    assert_close("adam.first", &chunked, &two, 1e-5);
    for (name, value) in &metrics {
        assert!((value - chunked_metrics[name]).abs() < 1e-5 * value.abs().max(0.1), "{name}");
    }
    // More minibatches than environments: those without any are no steps.
    assert_eq!(train_with(64, 0, 0).1, 2 * small_config().environments() as u64);
}

/// The rollout that is collected beside an update is that of an agent that makes no update; it is trained on, and a
/// saved state holds both sets of weights.
#[test]
fn beside_an_update_acts_the_policy_from_before_it() {
    let config = small_config();
    let fresh = || Agent::new(&config, Device::Cpu).expect("a fresh agent");
    let (mut straight, mut world) = (fresh(), World::new(&config));
    straight.overlap().expect("a thread");
    world.collect(&mut straight, 0, 4).expect("finite");
    straight.begin_update(0.1, 0);
    let beside = world.collect(&mut straight, 1, 4).expect("finite");
    let first = straight.finish_update().expect("finite");

    let (mut still, mut other_world) = (fresh(), World::new(&config));
    other_world.collect(&mut still, 0, 4).expect("finite");
    let (mut trained, mut third_world) = (fresh(), World::new(&config));
    third_world.collect(&mut trained, 0, 4).expect("finite");
    assert_eq!(trained.update(0.1, 0).expect("finite"), first);
    assert_eq!(straight.weights_digest(), trained.weights_digest(), "the update is the one that it always was");
    assert_ne!(third_world.collect(&mut trained, 1, 4).expect("finite"), beside, "the new policy values otherwise");
    assert_eq!(other_world.collect(&mut still, 1, 4).expect("finite"), beside);

    // Now the weights from before the second update act, which are those after the first.
    let state = straight.state();
    straight.abandon_rollout();
    let mut resumed = fresh();
    resumed.overlap().expect("a thread");
    resumed.load_state(&state).expect("the state fits");
    assert!(!state.tensors["acting.actor.weight"].equal(&state.tensors["model.actor.weight"]));
    let ends = [&mut straight, &mut resumed].map(|agent| {
        let mut world = World::new(&config);
        for rollout in 1..4 {
            world.collect(agent, rollout, 4).expect("finite");
            agent.begin_update(0.1, rollout as u64);
            world.collect(agent, rollout + 4, 4).expect("finite");
            agent.finish_update().expect("finite");
            agent.abandon_rollout();
        }
        agent.weights_digest()
    });
    assert_eq!(ends[0], ends[1]);
}

/// What breaks only after some steps of the optimiser, or after the last, is found as well.
#[test]
fn weights_that_break_during_an_update_are_as_they_were() {
    for (epochs, named) in [(1, "rollout 0: weight "), (2, "rollout 0: loss/")] {
        let mut config = small_config();
        // More than a 32-bit number holds: the first step leaves no weight finite.
        (config.ppo.learning_rate, config.ppo.epochs) = (1e39, epochs);
        let mut agent = Agent::new(&config, Device::Cpu).expect("a fresh agent");
        let digest = agent.weights_digest();
        World::new(&config).collect(&mut agent, 0, 4).expect("finite");
        let error = agent.update(0.0, 0).expect_err("no weight is finite");
        assert!(matches!(&error, AgentError::NonFinite { what } if what.starts_with(named)), "{error}");
        assert_eq!((agent.weights_digest(), agent.state().adam_steps), (digest, 0));
    }
}

#[test]
fn beside_an_update_that_fails_its_own_rollout_is_kept() {
    let config = small_config();
    let (mut agent, mut world) = (Agent::new(&config, Device::Cpu).expect("a fresh agent"), World::new(&config));
    agent.overlap().expect("a thread");
    let digest = agent.weights_digest();
    world.collect(&mut agent, 0, 4).expect("finite");
    agent.record(3, 1, Outcome { reward: f32::NAN, ..Outcome::default() });
    agent.begin_update(0.0, 0);
    world.collect(&mut agent, 1, 4).expect("finite");
    let error = agent.finish_update().expect_err("a reward is not a number");
    assert!(matches!(&error, AgentError::NonFinite { what } if what.contains("rollout 0: loss/")), "{error}");
    assert_eq!(agent.weights_digest(), digest);
    let rewards = to_vec(&agent.rollout_tensors()["rollout.reward"]);
    assert_eq!(rewards.iter().position(|reward| reward.is_nan()), Some(3 * 4 + 1));
}
