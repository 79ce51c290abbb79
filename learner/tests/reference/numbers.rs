//! Tasks of numbers alone: `learner probe` against `ppo.py` of `CleanRL`, and settings against their formulas.

use crate::repetition::saved_and_loaded;
use crate::shared::{Probed, assert_close, doubles, fixture, noise_f32, noise_tensor, probe, weight_values};
use crate::world::{World, mask, masked_config, numbers_config, privileged_config, weights_of};
use learner::agent::{Agent, StepInput};
use learner::network::to_vec;
use learner::optimizer::Adam;
use learner::rollout::Outcome;
use proto::config::{Activation, Config, Memory, PpoConfig, Shuffle};
use proto::metric;
use proto::stage::RolloutShape;
use proto::task::Spec;
use std::collections::BTreeMap;
use tch::{Device, Kind, Tensor};

const STEPS: i64 = 16;
const COLUMNS: i64 = 4;
/// Numbers of the task: speed, and one-hot those of the door and of the room would be five more.
const INPUTS: i64 = 6;
/// Numbers that the critic alone is given.
const PRIVILEGED: i64 = 3;
const HIDDEN: i64 = 16;

/// What `case` of `make_cleanrl.py` is given: actions of as many choices, or numbers if there are none.
fn batch(case: &str, choices: &[i64]) -> Vec<(&'static str, Tensor)> {
    let (truncated, masked, recurrent) = (case == "normalized", case.starts_with("masked"), case == "lstm");
    let inputs = INPUTS + if case == "privileged" { PRIVILEGED } else { 0 };
    let size = [STEPS, COLUMNS];
    let table = |name: &str| noise_tensor(&format!("cleanrl.{name}"), &size);
    let ended = table("ended").gt(0.7);
    let mut first = [true; COLUMNS as usize];
    // One goes on from the states that it is given.
    first[0] = !recurrent;
    let first = Tensor::from_slice(&first).view([1, COLUMNS]);
    let start = Tensor::cat(&[first, ended.narrow(0, 0, STEPS - 1)], 0);
    let cells = (0..STEPS).flat_map(|t| (0..COLUMNS).map(move |n| 3 * t + 5 * n));
    let options = cells.flat_map(|cell| (0..).zip(choices).map(move |(at, count)| (cell + at) % count));
    let options = Tensor::from_slice(&options.collect::<Vec<i64>>());
    let actions = match choices {
        [] => noise_tensor("cleanrl.drawn", &[STEPS, COLUMNS, 2]) * 2.0,
        [_] => options.view(size),
        several => options.view([STEPS, COLUMNS, several.len() as i64]),
    };
    let zeros = ended.zeros_like();
    let chosen = (0..).zip(choices).map(|(at, &count)| {
        let own = actions.view([STEPS, COLUMNS, -1]).select(2, at);
        own.onehot(count).to_kind(Kind::Bool)
    });
    let chosen: Vec<Tensor> = chosen.take_while(|_| masked).collect();
    let mask = (!chosen.is_empty()).then(|| {
        let chosen = Tensor::cat(&chosen, 2);
        noise_tensor("cleanrl.mask", &chosen.size()).gt(0.2).logical_or(&chosen)
    });
    let limit = if truncated { ended.logical_and(&table("limit").gt(0.0)) } else { zeros.shallow_clone() };
    // Of episodes that were not truncated none is known.
    let last_value = table("last_value").masked_fill(&limit.logical_not(), f64::NAN);
    let given = [
        ("numbers", noise_tensor("cleanrl.numbers", &[STEPS, COLUMNS, inputs]) * 2.0),
        ("previous_action", ended.zeros_like().to_kind(Kind::Int64)),
        ("episode_start", start),
        ("action", actions),
        ("log_prob", table("log_prob") * 0.25 - 1.25),
        ("value", table("value")),
        ("reward", table("reward")),
        ("time_limit", limit),
        ("last_value", last_value),
        ("ended", ended),
        ("disturbed", zeros),
        ("bootstrap", noise_tensor("cleanrl.bootstrap", &[COLUMNS])),
    ];
    let beliefs = recurrent.then(|| ("beliefs", noise_tensor("cleanrl.beliefs", &[COLUMNS, 2 * HIDDEN])));
    given.into_iter().chain(mask.map(|mask| ("mask", mask))).chain(beliefs).collect()
}

/// A task with [`INPUTS`] numbers and these actions, in a file for `learner probe`.
fn six_numbers(name: &str, actions: &str) -> String {
    let discrete = "kind = \"discrete\"\nnames = [\"left\", \"stay\", \"right\"]";
    let text = include_str!("../support/numbers.toml").replacen("name = \"numbers\"", &format!("name = \"{name}\""), 1);
    text.replacen("shape = [4]", "shape = [1]", 1).replacen(discrete, actions, 1)
}

/// Actions, and a channel behind them that is their mask.
fn masked(actions: &str, options: usize) -> String {
    format!(
        "{actions}\n[[channels]]\nname = \"action_mask\"\nrole = \"mask\"\ndtype = \"u8\"\nshape = [{options}]\ndoc = \"\"\n"
    )
}

/// Actions, and a channel behind them that the critic alone is given.
fn privileged(actions: &str) -> String {
    format!(
        "{actions}\n[[channels]]\nname = \"hidden\"\nrole = \"privileged\"\ndtype = \"f32\"\nshape = [{PRIVILEGED}]\n\
         range = [-9, 9]\ndoc = \"\"\n"
    )
}

/// Losses, advantages, returns and each gradient, to 1e-5 of the largest number.
#[test]
fn a_probe_finds_what_cleanrl_computes() {
    let expected = fixture("cleanrl");
    let discrete = "kind = \"discrete\"\nnames = [\"left\", \"stay\", \"right\"]";
    for (case, actions, choices, settings) in [
        ("defaults", discrete, &[3][..], "ppo.clip = 0.2"),
        ("plain", discrete, &[3], "ppo.clip = 0.2\nppo.clip_value = false\nppo.normalize_advantages = false"),
        ("narrow", discrete, &[3], "ppo.clip = 0.05\nppo.normalize_advantages = false"),
        ("choices", "kind = \"multi_discrete\"\ncounts = [3, 2]", &[3, 2], "ppo.clip = 0.2"),
        ("masked", &masked(discrete, 3), &[3], "ppo.clip = 0.2"),
        ("masked_choices", &masked("kind = \"multi_discrete\"\ncounts = [3, 2]", 5), &[3, 2], "ppo.clip = 0.2"),
        ("numbers", "kind = \"box\"\nbounds = [[-1, 1], [-2, 2]]", &[], "ppo.clip = 0.2"),
        ("lstm", discrete, &[3], "ppo.clip = 0.2\nnetwork.memory = \"lstm\"\nnetwork.hidden = 16"),
        ("privileged", &privileged(discrete), &[3], "ppo.clip = 0.2"),
        ("relu", discrete, &[3], "ppo.clip = 0.2\nnetwork.activation = \"relu\"\nppo.normalize_by_minibatch = true"),
        (
            "normalized",
            discrete,
            &[3],
            "ppo.clip = 0.2\nnormalize.observation_clip = 1.5\nnormalize.rewards = true\nnormalize.reward_clip = 5.0",
        ),
    ] {
        let name = format!("six_numbers_{case}");
        let task = Spec::declare(&six_numbers(&name, actions)).expect("a sound task");
        assert_eq!(task.inputs().expect("networks can take it").policy_width() as i64, INPUTS);
        let settings = format!("task = \"{name}\"\nppo.entropy_coefficient = 0.01\n{settings}\n");
        let config = Config::resolve_with("gym", Some((&settings, "a test"))).expect("it fits");
        let agent = Agent::new(&config, Device::Cpu).expect("a fresh agent");
        let value = |(name, weight): (String, Tensor)| (name.clone(), weight_values(&name, &weight.size()));
        let weights: Vec<(String, Tensor)> = weights_of(&agent).into_iter().map(value).collect();
        let batch = batch(case, choices);
        let statistics = [
            ("observation_norm.running_mean", noise_tensor("cleanrl.mean", &[INPUTS])),
            ("observation_norm.running_var", noise_tensor("cleanrl.var", &[INPUTS]) + 1.25),
            // Count, mean, squares of deviations.
            ("statistics.returns", Tensor::from_slice(&[500.0f64, 3.0, 8.0])),
        ];
        let statistics = statistics.iter().filter(|_| case == "normalized").map(|(name, one)| (*name, one));
        let all: Vec<_> = weights.iter().map(|(name, weight)| (name.as_str(), weight)).chain(statistics).collect();
        let Probed { good, said, found, .. } = probe(&all, &batch, &settings, Some(task.text()));
        assert!(good, "{case}: {said}");
        let mut compared = 0;
        for (name, theirs) in &expected {
            let Some(name) = name.strip_prefix(&format!("{case}.")) else { continue };
            let ours = found.get(name).unwrap_or_else(|| panic!("{name} is missing"));
            // What a mask forbids has no probability, and would hide other differences.
            let ours = if name == "log_probs" { ours.masked_fill(&ours.lt(-9e7), 0.0) } else { ours.shallow_clone() };
            assert_close(&format!("{case}: {name}"), &ours.view(theirs.size().as_slice()), theirs, 1e-5);
            compared += 1;
        }
        // A Gaussian has a table more, and its deviations; what remembers has beliefs, and states at the end.
        let gaussian = usize::from(weights.iter().any(|(name, _)| name == "log_std"));
        let of_memory = if case == "lstm" { 2 } else { 0 };
        assert_eq!((compared, weights.len()), (11 + gaussian + of_memory + weights.len(), 12 + gaussian), "{case}");
    }
}

/// Acting, advantages, and epochs of minibatches with clipping and Adam: weights to 1e-5 of the largest, and the means of
/// the losses.
#[test]
fn an_update_of_several_minibatches_is_cleanrls() {
    let expected = fixture("update");
    let (steps, columns) = (STEPS as usize, COLUMNS as usize);
    let discrete = "kind = \"discrete\"\nnames = [\"left\", \"stay\", \"right\"]";
    let boxed = "kind = \"box\"\nbounds = [[-1, 1], [-2, 2]]";
    let cases = [("discrete", discrete, 3), ("box", boxed, 2)];
    for ((name, actions, outputs), over) in cases.into_iter().flat_map(|case| [(case, "rollout"), (case, "minibatch")])
    {
        let task = format!("minibatches_{name}");
        Spec::declare(&six_numbers(&task, actions)).expect("a sound task");
        let settings = format!(
            "task = \"{task}\"\nseed = 7\nactors.count = 2\nactors.environments_per_actor = 2\n\
             ppo = {{ rollout_steps = {STEPS}, epochs = 3, minibatches = 4, clip = 0.2, learning_rate = 2.5e-3, \
             entropy_coefficient = 0.01, max_gradient_norm = 1.0, bootstrap_time_limits = false, \
             normalize_by_minibatch = {} }}",
            over == "minibatch"
        );
        let config = Config::resolve_with("gym", Some((&settings, "a test"))).expect("it fits");
        let mut agent = Agent::new(&config, Device::Cpu).expect("a fresh agent");
        let mut state = agent.state();
        for (name, tensor) in &mut state.tensors {
            if let Some(name) = name.strip_prefix("model.") {
                *tensor = weight_values(name, &tensor.size());
            }
        }
        agent.load_state(&state).expect("the state fits");

        let drawn = |name: &str, width: usize| noise_f32(&format!("cleanrl.{name}"), steps * columns * width);
        let doubled = |name: &str, width: usize| drawn(name, width).iter().map(|x| 2.0 * x).collect::<Vec<f32>>();
        let (numbers, after) = (doubled("numbers", INPUTS as usize), doubled("after", INPUTS as usize));
        let (draws, rewards, ended) = (doubled("draws", outputs), drawn("reward", 1), drawn("ended", 1));
        let all: Vec<usize> = (0..columns).collect();
        let row = columns * INPUTS as usize;
        let input = StepInput {
            columns: &all,
            frames: &[],
            images: &[],
            numbers: &after[..row],
            previous_action: &[0; COLUMNS as usize],
            episode_start: &[false; COLUMNS as usize],
            masks: &[],
            gumbel: &[],
        };
        agent.begin_rollout(RolloutShape::next(u64::MAX, steps, columns));
        for (t, gumbel) in draws.chunks_exact(columns * outputs).enumerate() {
            agent.step(t, &StepInput { numbers: &numbers[t * row..][..row], gumbel, ..input }).expect("finite");
            for n in 0..columns {
                let (reward, ended) = (rewards[t * columns + n], ended[t * columns + n] > 0.7);
                agent.record(t, n, Outcome { reward, ended, ..Outcome::default() });
            }
        }
        agent.bootstrap(&input).expect("finite");
        let chosen = agent.rollout_tensors()["rollout.action"].to_kind(Kind::Float);
        let metrics = agent.update(0.0, 0).expect("finite");

        let expected = |of: &str| &expected[&format!("{name}.{over}.{of}")];
        let actions = expected("actions");
        assert_close("actions", &chosen.view(actions.size().as_slice()), actions, 1e-6);
        let figures = [
            metric::POLICY_LOSS,
            metric::VALUE_LOSS,
            metric::ENTROPY,
            metric::CLIP_FRACTION,
            metric::APPROXIMATE_KL,
            metric::GRADIENT_NORM,
        ];
        for (figure, theirs) in figures.into_iter().zip(doubles(expected("figures"))) {
            let ours = metrics[figure];
            assert!((ours - theirs).abs() <= 1e-5 * theirs.abs(), "{name} {over} {figure}: {ours} is not {theirs}");
        }
        let weights = weights_of(&agent);
        assert_eq!(weights.len(), if name == "box" { 13 } else { 12 });
        for (weight, ours) in &weights {
            assert_close(weight, ours, expected(&format!("weight.{weight}")), 1e-5);
        }
    }
}

#[test]
fn a_state_of_numbers_is_saved_and_loaded() {
    let memories = [Memory::None, Memory::Gru, Memory::Lstm];
    for (memory, all) in memories.into_iter().flat_map(|memory| [(memory, false), (memory, true)]) {
        let mut config = numbers_config(memory);
        if all {
            with_all(&mut config);
        }
        // Other weights at first; but frames are dealt out by the seed.
        let (mut agent, mut world) = saved_and_loaded(&config, if all { config.seed } else { 99 }, false);
        let is_statistics = |name: &&String| name.starts_with("statistics.");
        assert_eq!(agent.state().tensors.keys().filter(is_statistics).count(), if all { 2 } else { 0 });
        world.collect(&mut agent, 3, 4).expect("finite");
        assert_eq!(agent.rollout_tensors()["rollout.numbers"].size(), [6, 4, 9], "{memory:?}");
    }
}

#[test]
fn adams_epsilon_stands_beside_the_root_of_the_second_moment() {
    for epsilon in [1e-8, 1e-5, 0.1] {
        let weights = Tensor::from_slice(&[1.0f32, -2.0]);
        let mut adam = Adam::new(&weights);
        let gradients = [[1e-3f32, 0.5], [2e-3, -0.25]];
        let (mut m, mut v, mut expected) = ([0.0f64; 2], [0.0f64; 2], [1.0, -2.0]);
        for (step, gradient) in (1..).zip(gradients) {
            adam.apply(&weights, &Tensor::from_slice(&gradient), &adam.factors(1, 0.01).get(0), epsilon);
            adam.steps += 1;
            for i in 0..2 {
                let g = f64::from(gradient[i]);
                (m[i], v[i]) = (0.9 * m[i] + 0.1 * g, 0.999 * v[i] + 0.001 * g * g);
                let (m, v) = (m[i] / (1.0 - 0.9f64.powi(step)), v[i] / (1.0 - 0.999f64.powi(step)));
                expected[i] -= 0.01 * m / (v.sqrt() + epsilon);
            }
        }
        for (ours, theirs) in doubles(&weights).into_iter().zip(expected) {
            assert!((ours - theirs).abs() < 1e-6, "{epsilon}: {ours} is not {theirs}");
        }
    }
}

/// An agent after one rollout and its update, and the update's figures.
fn updated(config: &Config, progress: f64) -> (Agent, BTreeMap<String, f64>) {
    let mut agent = Agent::new(config, Device::Cpu).expect("a fresh agent");
    World::new(config).collect(&mut agent, 0, 4).expect("finite");
    let figures = agent.update(progress, 0).expect("finite");
    (agent, figures)
}

/// Steps of the optimiser show how many epochs there were: none begins after one whose last minibatch has gone too far.
#[test]
fn epochs_end_where_the_policy_has_gone_as_far_as_it_may() {
    let steps = |target_kl: f64| {
        let mut config = numbers_config(Memory::None);
        (config.ppo.epochs, config.ppo.minibatches, config.ppo.target_kl) = (8, 2, target_kl);
        // Each epoch goes further.
        (config.ppo.learning_rate, config.ppo.environments_per_pass) = (3e-3, 0);
        let (agent, figures) = updated(&config, 0.0);
        (agent.state().adam_steps, figures[metric::APPROXIMATE_KL])
    };
    let (all, mean) = steps(0.0);
    assert_eq!(all, 16);
    assert!(mean > 0.0);
    assert_eq!(steps(1e-12).0, 2, "after the first epoch");
    assert_eq!(steps(1e3).0, 16);
    let (some, _) = steps(mean);
    assert!(some > 2 && some < 16 && some % 2 == 0, "{some}");
}

/// Nothing that is forbidden is chosen, by chance or without noise, and the update begins with the policy that acted.
#[test]
fn a_policy_with_masks_is_the_same_in_acting_and_in_the_update() {
    for (memory, shards) in [(Memory::None, 0), (Memory::Gru, 4)] {
        let mut config = masked_config(memory);
        (config.ppo.epochs, config.ppo.minibatches) = (1, 1);
        (config.actors.count, config.actors.environments_per_actor, config.learner.shards) = (4, 1, shards);
        let mut agent = Agent::new(&config, Device::Cpu).expect("a fresh agent");
        let mut world = World::new(&config);
        let outputs = world.collect(&mut agent, 0, 4).expect("finite");
        let (mut forbidden, columns) = (0, [0, 1, 2, 3]);
        for (t, output) in outputs.iter().enumerate() {
            for (n, &action) in output.actions.iter().enumerate() {
                let mask = mask(t, n, 3);
                assert!(mask[usize::from(action)], "{mask:?} {action}");
                forbidden += mask.iter().filter(|allowed| !**allowed).count();
            }
        }
        assert!(forbidden > 6, "{forbidden}");
        let kept = doubles(&agent.rollout_tensors()["rollout.mask"].to_kind(Kind::Double));
        assert_eq!(kept.iter().filter(|allowed| **allowed == 0.0).count(), forbidden);
        let figures = agent.update(0.0, 0).expect("finite");
        assert!(figures[metric::APPROXIMATE_KL].abs() < 1e-6, "{figures:?}");
        for now in 7..20 {
            let chosen = world.see(&mut agent, now, &columns, |agent, input| {
                agent.act(&StepInput { gumbel: &[0.0; 12], ..*input }).expect("finite").actions
            });
            assert!(columns.iter().zip(chosen).all(|(&n, action)| mask(now, n, 3)[usize::from(action)]));
        }
    }
}

/// Its one-hot code stands behind the six numbers of the policy.
#[test]
fn what_the_critic_alone_is_given_changes_values_and_no_policy() {
    for (memory, normalized) in [(Memory::None, false), (Memory::Gru, true), (Memory::Lstm, false)] {
        let mut config = privileged_config(memory);
        config.normalize.observations = normalized;
        let columns = [0, 1, 2, 3];
        let judged = |door: usize| {
            let mut agent = Agent::new(&config, Device::Cpu).expect("a fresh agent");
            agent.begin_rollout(RolloutShape::next(u64::MAX, 2, 4));
            World::new(&config).see(&mut agent, 0, &columns, |agent, input| {
                let mut numbers = input.numbers.to_vec();
                numbers.chunks_exact_mut(9).for_each(|row| (row[6..].fill(0.0), row[6 + door] = 1.0).1);
                let input = StepInput { numbers: &numbers, gumbel: &[0.0; 12], ..*input };
                let output = agent.step(0, &input).expect("finite");
                (output.actions, output.log_probs, output.values)
            })
        };
        let [(actions, log_probs, values), other] = [0, 2].map(judged);
        assert_eq!((&actions, &log_probs), (&other.0, &other.1), "{memory:?}");
        assert!(values.iter().zip(&other.2).all(|(one, other)| one != other), "{memory:?}: {values:?}");
    }
}

/// Everything that a rollout of numbers can be given.
fn with_all(config: &mut Config) {
    (config.ppo.bootstrap_time_limits, config.ppo.minibatches) = (true, 3);
    (config.normalize.observations, config.normalize.rewards) = (true, true);
    (config.ppo.entropy_coefficient_end, config.ppo.clip_end) = (0.0, 0.5);
    (config.ppo.normalize_by_minibatch, config.network.activation) = (true, Activation::Relu);
    if config.network.memory == Memory::None {
        config.ppo.shuffle = Shuffle::Rows;
    }
    config.validate().expect("a run can have this");
}

/// Means and variances one vector at a time (Welford 1962), of all columns as they come: not how they are computed.
#[test]
fn statistics_are_of_all_that_was_met() {
    let mut found = vec![];
    for shards in [0, 1, 2, 4] {
        let mut config = numbers_config(Memory::None);
        with_all(&mut config);
        (config.actors.count, config.actors.environments_per_actor, config.learner.shards) = (4, 1, shards);
        let mut agent = Agent::new(&config, Device::Cpu).expect("a fresh agent");
        let mut world = World::new(&config);
        // As Gymnasium begins.
        let mut known = vec![(1e-4, 0.0, 1e-4); 10];
        for rollout in 0..3 {
            world.collect(&mut agent, rollout, 4).expect("finite");
            let [numbers, returns] = {
                let dumped = agent.rollout_tensors();
                ["numbers", "discounted_return"].map(|name| doubles(&dumped[&format!("rollout.{name}")]))
            };
            agent.update(0.0, rollout as u64).expect("finite");
            for (numbers, discounted_return) in numbers.chunks_exact(9).zip(&returns) {
                for ((count, mean, squares), number) in known.iter_mut().zip(numbers.iter().chain([discounted_return]))
                {
                    *count += 1.0;
                    let before = number - *mean;
                    *mean += before / *count;
                    *squares += before * (number - *mean);
                }
            }
            let weights = weights_of(&agent);
            let [means, variances] =
                ["running_mean", "running_var"].map(|name| doubles(&weights[&format!("observation_norm.{name}")]));
            for i in 0..9 {
                let (count, mean, squares) = known[i];
                // Speed alone is a vector; door and room are one-hot.
                let expected = if i < 4 { [mean, squares / count] } else { [0.0, 1.0] };
                assert!((means[i] - expected[0]).abs() < 1e-6 && (variances[i] - expected[1]).abs() < 1e-5, "{i}");
            }
            let saved = doubles(&agent.state().tensors["statistics.returns"]);
            let (count, mean, squares) = known[9];
            assert!((saved[0] - count).abs() < 1e-9 && (saved[1] - mean).abs() < 1e-9);
            assert!((saved[2] - squares).abs() < 1e-9 * squares, "{saved:?}");
        }
        found.push(doubles(&agent.state().tensors["statistics.observations"]));
    }
    assert!(found.iter().all(|one| *one == found[0]), "the same bits for every number of shards");
}

/// As Gymnasium's wrapper scales them: also those of the first rollout.
#[test]
fn rewards_are_scaled_by_returns_of_their_own_rollout() {
    let trained = |returns: f64| {
        let mut config = numbers_config(Memory::None);
        config.normalize.rewards = true;
        let mut agent = Agent::new(&config, Device::Cpu).expect("a fresh agent");
        let mut world = World::new(&config);
        world.returns = returns;
        world.collect(&mut agent, 0, 4).expect("finite");
        agent.update(0.0, 0).expect("finite");
        agent.weights_digest()
    };
    assert_ne!(trained(20.0), trained(40.0));
}

/// The bonus ends at nothing, and a rollout's steps are dealt out anew in each epoch.
#[test]
fn the_entropy_bonus_and_the_clip_range_fall_with_the_learning_rate() {
    let digest = |set: &dyn Fn(&mut PpoConfig), progress: f64| {
        let mut config = numbers_config(Memory::None);
        (config.ppo.learning_rate_end, config.ppo.clip_value) = (1.0, true);
        set(&mut config.ppo);
        updated(&config, progress).0.weights_digest()
    };
    let entropy = |coefficient, end, progress| {
        digest(&|ppo| (ppo.entropy_coefficient, ppo.entropy_coefficient_end) = (coefficient, end), progress)
    };
    assert_eq!(entropy(0.5, 0.0, 1.0), entropy(0.0, 1.0, 0.3));
    assert_eq!(entropy(0.5, 0.0, 0.5), entropy(0.25, 1.0, 0.3));
    assert_ne!(entropy(0.5, 0.0, 0.5), entropy(0.5, 1.0, 0.5));
    let clip = |clip, end, progress| digest(&|ppo| (ppo.clip, ppo.clip_end) = (clip, end), progress);
    assert_eq!(clip(0.02, 0.0, 0.5), clip(0.01, 1.0, 0.3));
    assert_ne!(clip(0.02, 0.0, 0.5), clip(0.02, 1.0, 0.5));
}

/// One minibatch is the rollout; but its deviation has another number added.
#[test]
fn advantages_are_normalised_over_what_is_configured() {
    let trained = |by_minibatch: bool, minibatches: u32| {
        let mut config = numbers_config(Memory::None);
        (config.ppo.normalize_by_minibatch, config.ppo.minibatches) = (by_minibatch, minibatches);
        weights_of(&updated(&config, 0.0).0)
    };
    let apart = |minibatches: u32| {
        let [one, other] = [false, true].map(|by_minibatch| trained(by_minibatch, minibatches));
        let apart = one.iter().map(|(name, weight)| (weight - &other[name]).abs().max().double_value(&[]));
        apart.fold(0.0, f64::max)
    };
    let [of_one, of_three] = [apart(1), apart(3)];
    assert!(of_one < 1e-5 && of_three > 1e-4, "{of_one} {of_three}");
}

#[test]
fn initial_weights_and_deviations_are_as_configured() {
    let task = six_numbers("six_numbers_uniform", "kind = \"box\"\nbounds = [[-1, 1], [-2, 2]]");
    Spec::declare(&task).expect("a sound task");
    let settings = "task = \"six_numbers_uniform\"\nnetwork.initial = \"uniform\"\nnetwork.log_std = -2.0";
    let config = Config::resolve_with("gym", Some((settings, "a test"))).expect("it fits");
    let weights = weights_of(&Agent::new(&config, Device::Cpu).expect("a fresh agent"));
    assert_eq!(to_vec(&weights["log_std"]), [-2.0; 2]);
    for (layer, inputs) in [("actor.0", 6.0f64), ("actor.4", 64.0), ("critic.2", 64.0), ("critic.4", 64.0)] {
        for of in ["weight", "bias"] {
            let (values, bound) = (doubles(&weights[&format!("{layer}.{of}")]), 1.0 / inputs.sqrt());
            assert!(values.iter().all(|value| value.abs() <= bound && *value != 0.0), "{layer}.{of}: {values:?}");
            // Of few numbers the greatest may be small.
            assert!(values.len() < 16 || values.iter().any(|value| value.abs() > 0.7 * bound), "{layer}.{of}");
        }
    }
}

/// What was seen last of a truncated episode has the value that a rollout's end there bootstraps from: with the belief
/// of that episode, not of the next. Without memory it is the critic's two layers, by hand.
#[test]
fn a_truncated_episode_is_valued_by_what_was_seen_last() {
    for memory in [Memory::None, Memory::Gru, Memory::Lstm] {
        let mut config = numbers_config(memory);
        (config.ppo.bootstrap_time_limits, config.network.previous_action) = (true, true);
        let mut agent = Agent::new(&config, Device::Cpu).expect("a fresh agent");
        let (last, place) = (noise_tensor("last", &[9]), "rollout.last_value");
        let numbers: Vec<f32> = to_vec(&last);
        let world = World::new(&config);
        let columns: Vec<usize> = (0..4).collect();
        agent.begin_rollout(RolloutShape::next(u64::MAX, 2, 4));
        let mut chosen = vec![];
        for t in 0..2 {
            let output = world.see(&mut agent, t, &columns, |agent, input| {
                let gumbel = vec![0.0; 4 * 3];
                agent.step(t, &StepInput { gumbel: &gumbel, ..*input }).expect("finite")
            });
            for column in 0..4 {
                let ended = t == 1 && column == 2;
                agent.record(t, column, Outcome { ended, time_limit: ended, ..Outcome::default() });
            }
            chosen = output.actions;
        }
        assert!(to_vec(&agent.rollout_tensors()[place]).iter().all(|value| value.is_nan()));
        agent.value_last(1, 2, &numbers).expect("finite");
        let found = to_vec(&agent.rollout_tensors()[place])[4 + 2];
        world.see(&mut agent, 2, &columns, |agent, input| {
            let mut all = input.numbers.to_vec();
            all[2 * 9..][..9].copy_from_slice(&numbers);
            let input = StepInput { numbers: &all, previous_action: &chosen, episode_start: &[false; 4], ..*input };
            agent.bootstrap(&input).expect("finite");
        });
        let bootstrap = to_vec(&agent.rollout_tensors()["rollout.bootstrap"])[2];
        assert!((found - bootstrap).abs() < 1e-6, "{memory:?}: {found} is not {bootstrap}");
        if memory == Memory::None {
            let weights = weights_of(&agent);
            let action = weights["previous_action_embedder.weight"].get(1 + i64::from(chosen[2]));
            let layer = |x: Tensor, at: usize| {
                let [weight, bias] = ["weight", "bias"].map(|of| &weights[&format!("critic.{at}.{of}")]);
                weight.mv(&x) + bias
            };
            let x = layer(layer(Tensor::cat(&[last, action], 0), 0).tanh(), 2).tanh();
            let by_hand = layer(x, 4).double_value(&[0]);
            assert!((f64::from(found) - by_hand).abs() < 1e-6, "{found} is not {by_hand}");
        }
    }
}
