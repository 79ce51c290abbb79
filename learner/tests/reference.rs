//! The learner's mathematics against PyTorch: `tests/reference/make_fixtures.py` is the method written a second time,
//! its results are the `.safetensors` beside it. Also here: what must be bit-identical on the CPU.
//!
//! All in one binary because loading libtorch takes longer than most of these tests.

#[path = "support/environment.rs"]
#[allow(dead_code, reason = "only its empty transition is needed here")]
mod environment;

use environment::no_transition;

use learner::agent::{Agent, AgentError, AgentState, Outcome, StepInput, StepOutput};
use learner::auxiliary::{Answer, Auxiliary, Cpca, Disturb, InverseDynamics, Pass, Query, focal_loss};
use learner::collector::{RolloutStatistics, RunningEpisode};

use learner::import::import;
use learner::network::{
    Judgement, Layout, Network, Observations, Packing, Parameters, RawFrame, Staging, goal_coordinates, to_vec,
};
use learner::optimizer::{Adam, clip_norm, learning_rate};
use learner::ppo::gae;
use learner::ppo::loss::{Experience, terms};
use learner::rollout::{Rollout, Step};
use proto::action::{ActionSpace, NO_ACTION};
use proto::config::{AuxiliaryTask, Config, Encoder, GoalCoordinates, LagrangianConfig};
use proto::control::metric;
use proto::message::{FRAME_PIXELS, FRAME_SIDE, Transition};
use proto::reward::{RewardKind, RewardParts};
use proto::stage::RolloutShape;
use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;
use tch::{Device, Kind, Tensor};

// What both sides share ---------------------------------------------------------------------------------------------

/// `noise` of the script.
fn noise(name: &str, count: usize) -> Vec<f64> {
    let seed = name.bytes().fold(0x811c_9dc5u32, |hash, byte| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193));
    (0..count as u32)
        .map(|index| {
            let mut x = index.wrapping_mul(0x9e37_79b9).wrapping_add(seed);
            x ^= x >> 16;
            x = x.wrapping_mul(0x85eb_ca6b);
            x ^= x >> 13;
            x = x.wrapping_mul(0xc2b2_ae35);
            x ^= x >> 16;
            f64::from(x) / 2_147_483_648.0 - 1.0
        })
        .collect()
}

fn noise_f32(name: &str, count: usize) -> Vec<f32> {
    noise(name, count).into_iter().map(|value| value as f32).collect()
}

fn noise_tensor(name: &str, shape: &[i64]) -> Tensor {
    Tensor::from_slice(&noise_f32(name, shape.iter().product::<i64>() as usize)).view(shape)
}

/// `set_weights` of the script.
fn weight_values(name: &str, shape: &[i64]) -> Tensor {
    let count = shape.iter().product::<i64>();
    let values: Vec<f32> = noise(name, count as usize)
        .into_iter()
        .map(|value| {
            let fan_in = count / shape[0];
            // A one-dimensional `weight` is the scale of a normalisation.
            let scale = if name.ends_with(".weight") { 1.0 } else { 0.0 };
            if shape.len() > 1 { value * (3.0 / fan_in as f64).sqrt() } else { 0.1 * value + scale }
        })
        .map(|value| value as f32)
        .collect();
    Tensor::from_slice(&values).view(shape)
}

fn depth_mm(t: usize, n: usize) -> Box<RawFrame> {
    let tiles = noise(&format!("frame.{t}.{n}"), 28 * 28);
    let mut frame: Box<RawFrame> = vec![0; FRAME_PIXELS].try_into().expect("a frame's pixels");
    for (pixel, depth_mm) in frame.iter_mut().enumerate() {
        let (row, column) = (pixel / FRAME_SIDE, pixel % FRAME_SIDE);
        let tile = ((tiles[row / 8 * 28 + column / 8] + 1.0) * 2048.0).floor();
        *depth_mm = tile as u16 + column as u16;
    }
    frame
}

fn goal_m(t: usize, n: usize) -> [f32; 3] {
    let values = noise_f32(&format!("goal.{t}.{n}"), 3);
    [values[0] * 2.0, values[1] * 2.0, values[2] * 2.0]
}

fn fixture(name: &str) -> BTreeMap<String, Tensor> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/reference").join(format!("{name}.safetensors"));
    Tensor::read_safetensors(&path).expect("the fixture is committed").into_iter().collect()
}

fn doubles(tensor: &Tensor) -> Vec<f64> {
    Vec::<f64>::try_from(tensor.detach().to_kind(Kind::Double).contiguous().view(-1)).expect("numbers")
}

#[track_caller]
fn assert_close(what: &str, ours: &Tensor, theirs: &Tensor, tolerance: f64) {
    assert_eq!(ours.size(), theirs.size(), "{what}");
    let theirs = doubles(theirs);
    let scale = theirs.iter().fold(0f64, |scale, value| scale.max(value.abs())).max(1e-12);
    for (index, (a, b)) in doubles(ours).iter().zip(&theirs).enumerate() {
        assert!((a - b).abs() <= tolerance * scale, "{what}[{index}]: {a} is not {b}, scale {scale}");
    }
}

/// Compares named tensors with the script's `probes`: norms, and products with noise.
#[track_caller]
fn assert_probes(named: &BTreeMap<String, Tensor>, probes: &Tensor, tolerance: f64) {
    let probes = doubles(probes);
    assert_eq!(named.len() * 2, probes.len());
    for ((name, tensor), probe) in named.iter().zip(probes.chunks(2)) {
        let values = doubles(tensor);
        let norm = values.iter().map(|v| v * v).sum::<f64>().sqrt();
        let product: f64 = values.iter().zip(noise(&format!("probe.{name}"), values.len())).map(|(a, b)| a * b).sum();
        assert!((norm - probe[0]).abs() <= tolerance * probe[0], "norm of {name}: {norm} is not {}", probe[0]);
        assert!((product - probe[1]).abs() <= tolerance * probe[0], "{name}: {product} is not {}", probe[1]);
    }
}

// The network -------------------------------------------------------------------------------------------------------

fn network_matches(name: &str, config: &Config) {
    let actions = config.episode.action_space.actions().len() as i64;
    let hidden = i64::from(config.network.hidden);
    let (network, head) =
        Network::new(config, Device::Cpu, |layout, hidden| Disturb::new(layout, [hidden, actions], 2.0));
    let parameters = &network.parameters;
    tch::no_grad(|| {
        for (name, mut weight) in parameters.named() {
            weight.copy_(&weight_values(name, &weight.size()));
        }
    });
    let starts = [[false, false, true], [false, true, false], [true, false, false]];
    let at_start = noise_tensor("belief", &[3, hidden]);
    let observe = |rows: &[(usize, usize)]| {
        let frames: Vec<Box<RawFrame>> = rows.iter().map(|&(t, n)| depth_mm(t, n)).collect();
        let frames: Vec<&RawFrame> = frames.iter().map(|frame| &**frame).collect();
        let goals: Vec<f32> =
            rows.iter().flat_map(|&(t, n)| goal_coordinates(config.network.goal, goal_m(t, n))).collect();
        let previous: Vec<i64> = rows.iter().map(|&(t, n)| (5 * t + 3 * n) as i64 % (actions + 1)).collect();
        Observations {
            frames: network.preparation.keep(&frames, &mut Staging::default()),
            goals: Tensor::from_slice(&goals).view([-1, 3]),
            previous_actions: Tensor::from_slice(&previous),
        }
    };
    let expected = fixture(&format!("network_{name}"));

    // Acting: a step at a time.
    let mut belief = at_start.copy();
    for (t, start) in starts.iter().enumerate() {
        let carried = Tensor::from_slice(&start.map(|start| if start { 0f32 } else { 1.0 })).unsqueeze(1);
        let embedded = network.embed(&observe(&[0, 1, 2].map(|n| (t, n))));
        belief = network.belief.step(parameters, &embedded, &(belief * carried));
        let Judgement { log_probs, values } = network.judge(&belief);
        assert_close("acting log_probs", &log_probs, &expected["log_probs"].get(t as i64), 1e-5);
        assert_close("acting values", &values, &expected["values"].get(t as i64), 1e-5);
    }
    assert_close("acting beliefs", &belief, &expected["beliefs"], 1e-5);

    // Training: all at once, packed.
    let packing = Packing::new(0..3, |_| 3, |t, n| starts[t][n]);
    let embedded = network.embed(&observe(&packing.rows));
    let beliefs = network.belief.unroll(parameters, &embedded, &packing, &at_start);
    let Judgement { log_probs, values } = network.judge(&beliefs);
    let at = |table: &Tensor| {
        let rows: Vec<Tensor> = packing.rows.iter().map(|&(t, n)| table.get(t as i64).get(n as i64)).collect();
        Tensor::stack(&rows, 0)
    };
    assert_close("log_probs", &log_probs, &at(&expected["log_probs"]), 1e-5);
    assert_close("values", &values, &at(&expected["values"]), 1e-5);

    let pull = |name: &str, shape: &[i64]| {
        let steps: Vec<Tensor> = (0..3).map(|t| noise_tensor(&format!("pull.{name}.{t}"), shape)).collect();
        at(&Tensor::stack(&steps, 0))
    };
    let loss = (log_probs * pull("policy", &[3, actions])).sum(Kind::Float)
        + (values * pull("value", &[3])).sum(Kind::Float)
        + (head.logits(parameters, &beliefs) * pull("disturb", &[3, actions])).sum(Kind::Float);
    let gradient = parameters.gradient_of(&loss);
    let mut offset = 0;
    let gradients = parameters
        .named()
        .map(|(name, weight)| {
            let count = weight.numel() as i64;
            offset += count;
            (name.to_owned(), gradient.narrow(0, offset - count, count))
        })
        .collect();
    assert_probes(&gradients, &expected["gradients"], 1e-5);
}

#[test]
fn the_papers_network_is_pytorchs() {
    network_matches("resnet", &Config::default());
}

#[test]
fn the_baselines_network_is_pytorchs() {
    let mut config = Config::default();
    config.network.encoder = Encoder::Cnn;
    config.network.input_pool = 1;
    config.network.goal = GoalCoordinates::Cartesian;
    config.network.previous_action = false;
    config.network.hidden = 64;
    config.episode.action_space = ActionSpace::Small;
    network_matches("cnn", &config);
}

// The algorithm -----------------------------------------------------------------------------------------------------

#[test]
fn advantages_are_the_explicit_sums() {
    let (steps, columns) = (12, 5);
    let float = (Kind::Float, Device::Cpu);
    let shape = RolloutShape { steps, environments_in_last_step: 3, frames: 58 };
    let frames = Tensor::zeros([60, 1, 1], float);
    let mut rollout = Rollout::new(shape, columns, frames, Tensor::zeros([5, 1], float));
    let all = [0, 1, 2, 3, 4];
    let table = |name: &str| noise_f32(name, steps * columns);
    let (rewards, values) = (table("gae.reward"), table("gae.value"));
    let (ended, limit) = (noise("gae.ended", steps * columns), noise("gae.limit", steps * columns));
    for t in 0..steps {
        let rows = all.map(|n| Step { value: 2.0 * values[t * columns + n], ..Step::default() });
        rollout.store(t, &all, &Tensor::zeros([5, 1, 1], float), &rows);
        for n in all.into_iter().filter(|&n| t + 1 < steps || n < 3) {
            let index = t * columns + n;
            let ended = ended[index] > 0.6;
            let time_limit = ended && limit[index] > 0.0;
            rollout.record(t, n, Outcome { reward: rewards[index], ended, time_limit, disturbed: false });
        }
    }
    for (n, value) in noise_f32("gae.after", columns).into_iter().enumerate().take(3) {
        rollout.set_bootstrap(n, value);
    }
    let expected = fixture("gae");
    for (name, bootstrap_time_limits) in [("terminal", false), ("truncated", true)] {
        for (figure, normalize_advantages) in [("advantages", false), ("normalized", true)] {
            let ppo = proto::config::PpoConfig { bootstrap_time_limits, normalize_advantages, ..Default::default() };
            let targets = gae::estimate(&rollout, &ppo);
            let collect = |of: &dyn Fn((usize, usize)) -> f32| {
                let values: Vec<f32> = (0..steps * columns).map(|i| of((i / columns, i % columns))).collect();
                Tensor::from_slice(&values).view([12, 5])
            };
            let theirs = &expected[&format!("{name}.{figure}")];
            assert_close(figure, &collect(&|row| targets.advantage(row)), theirs, 1e-6);
            let theirs = &expected[&format!("{name}.returns")];
            assert_close("returns", &collect(&|row| targets.value_target(row)), theirs, 1e-6);
        }
    }
}

#[test]
fn the_losses_and_their_gradients_are_the_formulas() {
    let rows = 40;
    let expected = fixture("loss");
    let logits = (noise_tensor("loss.logits", &[rows, 21]) * 2.0).set_requires_grad(true);
    let values = noise_tensor("loss.values", &[rows]).set_requires_grad(true);
    let experience = Experience {
        actions: Tensor::from_slice(&(0..rows).map(|i| (7 * i) % 21).collect::<Vec<_>>()),
        log_probs: expected["old_log_probs"].shallow_clone(),
        values: values.detach() + noise_tensor("loss.value_drift", &[rows]) * 0.3,
        advantages: noise_tensor("loss.advantages", &[rows]),
        returns: noise_tensor("loss.returns", &[rows]),
    };
    // In two passes, which must add up to the whole.
    let mut sums = Tensor::zeros([5], (Kind::Float, Device::Cpu));
    let mut loss = Tensor::zeros([] as [i64; 0], (Kind::Float, Device::Cpu));
    for (first, count) in [(0, 15), (15, 25)] {
        let cut = |tensor: &Tensor| tensor.narrow(0, first, count);
        let judgement = Judgement { log_probs: cut(&logits).log_softmax(-1, None), values: cut(&values) };
        let part = Experience {
            actions: cut(&experience.actions),
            log_probs: cut(&experience.log_probs),
            values: cut(&experience.values),
            advantages: cut(&experience.advantages),
            returns: cut(&experience.returns),
        };
        let terms = terms(&judgement, &part, 0.1, rows as u64);
        loss += &terms.policy + &terms.value * 0.5 - &terms.entropy * 0.01;
        let scalars = [terms.policy, terms.value, terms.entropy, terms.clip_fraction, terms.approximate_kl];
        sums += Tensor::stack(&scalars, 0).detach();
    }
    assert_close("terms", &sums, &expected["terms"], 1e-5);
    let gradients = Tensor::run_backward(&[loss], &[&logits, &values], false, false);
    assert_close("gradient of logits", &gradients[0], &expected["gradient.logits"], 1e-5);
    assert_close("gradient of values", &gradients[1], &expected["gradient.values"], 1e-5);

    let logits = (noise_tensor("focal.logits", &[rows]) * 6.0).set_requires_grad(true);
    let labels = noise_tensor("focal.labels", &[rows]).gt(0.5).to_kind(Kind::Float);
    let focal = focal_loss(&logits, &labels, 2.0);
    assert_close("focal loss", &focal, &expected["focal"], 1e-5);
    let gradient = Tensor::run_backward(&[focal.mean(Kind::Float)], &[&logits], false, false);
    assert_close("gradient of focal loss", &gradient[0], &expected["gradient.focal"], 1e-5);
}

/// A hundred updates of a smooth problem: what differs in the last bits does not grow.
#[test]
fn adam_with_clipping_and_schedule_is_pytorchs() {
    let expected = fixture("adam");
    let (points, waves, updates) = (200, 64, 100i64);
    let inputs = noise_tensor("adam.inputs", &[points, waves]);
    let target = noise_tensor("adam.target", &[points]) * 3.0;
    let mut weights = noise_tensor("adam.weights", &[waves]);
    let mut adam = Adam::new(&weights);
    for update in 0..updates {
        let leaf = weights.copy().set_requires_grad(true);
        let loss = (inputs.mv(&leaf).sin() - &target).square().mean(Kind::Float);
        let theirs = expected["losses"].double_value(&[update]);
        let ours = loss.double_value(&[]);
        assert!((ours - theirs).abs() < 1e-6 * theirs, "update {update}: loss {ours} is not {theirs}");
        let mut gradient = Tensor::run_backward(&[loss], &[leaf], false, false).remove(0);
        let norm = clip_norm(&mut gradient, 0.5);
        let theirs = expected["norms"].double_value(&[update]);
        assert!((norm - theirs).abs() < 1e-5 * theirs, "update {update}: norm {norm} is not {theirs}");
        adam.step(&mut weights, &gradient, learning_rate(3e-2, 1.0 / 3.0, update as f64 / updates as f64));
        if update % 10 == 9 {
            assert_close("weights", &weights, &expected["weights"].get(update / 10), 1e-6);
        }
    }
    assert_eq!(adam.steps, 100);
}

#[test]
fn goal_sensors_agree_in_every_octant_and_on_every_axis() {
    let expected = fixture("goal");
    let goals: Vec<f64> = doubles(&expected["goals"]);
    assert_eq!(goals.len(), 4 * 27 * 3);
    for (kind, name, tolerance) in
        [(GoalCoordinates::Polar, "polar", 1e-6), (GoalCoordinates::Cartesian, "cartesian", 0.0)]
    {
        for (goal, theirs) in goals.chunks(3).zip(doubles(&expected[name]).chunks(3)) {
            let goal = [0, 1, 2].map(|axis| goal[axis] as f32);
            for (ours, theirs) in goal_coordinates(kind, goal).into_iter().zip(theirs) {
                let difference = (f64::from(ours) - theirs).abs();
                assert!(difference <= tolerance * theirs.abs().max(1.0), "{name} of {goal:?}: {ours} is not {theirs}");
            }
        }
    }
}

#[test]
fn the_multiplier_follows_the_mean_discounted_disturbance_of_ended_episodes() {
    let (rollouts, steps, columns) = (12, 8, 3);
    let cells = rollouts * steps * columns;
    let progress: Vec<f32> =
        noise("lagrangian.progress", cells).into_iter().map(|value| (value * 0.02) as f32).collect();
    let ended = noise("lagrangian.ended", cells);
    let mut config = small_config();
    config.reward.lagrangian = LagrangianConfig { initial: 0.01, learning_rate: 2.0 };
    let mut agent = Agent::new(&config, Device::Cpu).expect("a fresh agent");
    let mut running = [(0, RunningEpisode::default()); 3];
    let mut trace = vec![];
    for rollout in 0..rollouts {
        let mut statistics = RolloutStatistics::default();
        for t in 0..steps {
            for (n, (step, episode)) in running.iter_mut().enumerate() {
                let cell = (rollout * steps + t) * columns + n;
                let reward = RewardParts { disturbance_progress_m: progress[cell], ..RewardParts::default() };
                let transition = Transition { step: *step, reward, ..no_transition() };
                episode.add(&transition, 0.0, 0.99);
                *step += 1;
                if ended[cell] > 0.75 && rollout != 3 {
                    statistics.add_episode(&transition, episode);
                    (*step, *episode) = (0, RunningEpisode::default());
                }
            }
        }
        agent.constrain(statistics.mean_discounted_disturbance_m());
        trace.push(agent.multiplier());
    }
    assert_close("multiplier", &Tensor::from_slice(&trace), &fixture("lagrangian")["trace"], 1e-12);
    // What the policy is rewarded with follows it.
    assert_eq!(agent.disturbance_weight(RewardKind::Lagrangian), agent.multiplier() as f32);
    assert_eq!(agent.disturbance_weight(RewardKind::DisturbanceFree), 15.0);
    let saved = agent.state();
    agent.start_stage();
    assert_eq!(agent.multiplier(), 0.01, "a stage begins anew");
    agent.load_state(&saved).expect("the state fits");
    assert_eq!(agent.multiplier(), trace[rollouts - 1]);
}

/// Inverse dynamics and CPC|A as tensor operations against the script's loops, one question at a time.
#[test]
fn auxiliary_tasks_are_their_definitions() {
    let (steps, columns, hidden, actions) = (20, 4, 24, 21);
    let cells = steps * columns;
    let starts: Vec<bool> = noise("auxiliary.starts", cells).into_iter().map(|value| value > 0.8).collect();
    let length = |n: usize| steps - usize::from(n + 1 == columns);
    let packing = Packing::new(0..columns, length, |t, n| starts[t * columns + n]);
    let cells_of_rows: Vec<i64> = packing.rows.iter().map(|&(t, n)| (t * columns + n) as i64).collect();
    let of_rows = Tensor::from_slice(&cells_of_rows);
    let table = |name: &str, width: i64| {
        noise_tensor(name, &[cells as i64, width]).index_select(0, &of_rows).set_requires_grad(true)
    };
    let (embeddings, beliefs) = (table("auxiliary.embeddings", 544), table("auxiliary.beliefs", hidden));
    let taken: Vec<i64> = packing.rows.iter().map(|&(t, n)| ((3 * t + 5 * n + t * n) % 21) as i64).collect();
    let queries = |horizon: usize| -> Vec<Query> {
        (1..=horizon)
            .flat_map(|offset| {
                let chosen = noise(&format!("auxiliary.chosen.{offset}"), cells);
                let later = (0i64..).zip(packing.later(offset)).zip(&cells_of_rows);
                later
                    .filter(|&(_, &cell)| chosen[cell as usize] > 0.4)
                    .filter_map(|((row, later), _)| {
                        Some(Query { row, offset: offset as i64, later: later?, elsewhere: 0 })
                    })
                    .collect::<Vec<_>>()
            })
            .collect()
    };
    // The script permutes the valid cells in the order of steps.
    let mut valid = cells_of_rows.clone();
    valid.sort_unstable();
    let keys = noise("auxiliary.negatives", valid.len());
    let mut order: Vec<usize> = (0..valid.len()).collect();
    order.sort_by(|&a, &b| keys[a].total_cmp(&keys[b]));
    let row_of = |cell: i64| cells_of_rows.iter().position(|&other| other == cell).expect("a valid cell") as i64;
    let negatives: Vec<i64> = cells_of_rows
        .iter()
        .map(|cell| row_of(valid[order[valid.binary_search(cell).expect("a valid cell")]]))
        .collect();

    let shape = RolloutShape { steps, environments_in_last_step: columns - 1, frames: (cells - 1) as u64 };
    let float = (Kind::Float, Device::Cpu);
    let rollout =
        Rollout::new(shape, columns, Tensor::zeros([cells as i64, 1, 1], float), Tensor::zeros([4, hidden], float));
    let actions_taken = Tensor::from_slice(&taken);
    let pass = Pass {
        rollout: &rollout,
        packing: &packing,
        embeddings: &embeddings,
        beliefs: &beliefs,
        actions: &actions_taken,
    };
    let expected = fixture("auxiliary");
    let check = |name: &str, parameters: &Parameters, asked: usize, answer: Answer| {
        let loss = doubles(&expected[&format!("{name}.loss")]);
        assert_eq!(asked as f64, loss[1], "{name}: questions");
        let ours = answer.loss.double_value(&[]);
        assert!((ours - loss[0]).abs() < 1e-5 * loss[0], "{name}: {ours} is not {}", loss[0]);
        let mut named: BTreeMap<String, Tensor> = BTreeMap::new();
        let leaves: Vec<Tensor> = parameters.ids().map(|id| parameters[id].shallow_clone()).collect();
        let names = parameters.named().map(|(name, _)| name.to_owned());
        let inputs: Vec<&Tensor> = leaves.iter().chain([&beliefs, &embeddings]).collect();
        let gradients = Tensor::run_backward(&[answer.loss], &inputs, false, false);
        // Back from rows to cells: the cell that no row has gets no gradient.
        let scatter = |gradient: &Tensor| {
            let mut cells = Tensor::zeros([cells as i64, gradient.size()[1]], float);
            let _ = cells.index_copy_(0, &of_rows, gradient);
            cells
        };
        let count = leaves.len();
        named.extend(names.zip(gradients[..count].iter().map(Tensor::shallow_clone)));
        named.insert("auxiliary.beliefs".into(), scatter(&gradients[count]));
        named.insert("auxiliary.embeddings".into(), scatter(&gradients[count + 1]));
        assert_probes(&named, &expected[&format!("{name}.gradients")], 1e-5);
    };
    let weights = |layout: Layout| {
        let parameters = Parameters::new(layout, 1, Device::Cpu);
        tch::no_grad(|| {
            for (name, mut weight) in parameters.named() {
                weight.copy_(&weight_values(name, &weight.size()));
            }
        });
        parameters
    };

    let mut layout = Layout::default();
    let inverse = InverseDynamics::new(&mut layout, [hidden, actions]);
    let parameters = weights(layout);
    let asked = queries(1);
    let answer = inverse.loss(&parameters, &pass, &asked, asked.len() as u64);
    check("inverse_dynamics", &parameters, asked.len(), answer);

    let mut layout = Layout::default();
    let cpca = Cpca::new(&mut layout, [hidden, actions]);
    let parameters = weights(layout);
    let mut asked = queries(16);
    for query in &mut asked {
        query.elsewhere = negatives[query.later as usize];
    }
    let answer = cpca.loss(&parameters, &pass, &asked, asked.len() as u64);
    check("cpca16", &parameters, asked.len(), answer);
}

// The whole ---------------------------------------------------------------------------------------------------------

/// A world of noise that an agent acts in: the script's `run_fixture`.
struct World {
    columns: usize,
    steps: usize,
    /// Steps that a rollout is planned with; it is cut after `steps`.
    planned: usize,
    previous: Vec<u8>,
}

fn small_config() -> Config {
    let mut config = Config::default();
    config.actors.count = 2;
    config.actors.environments_per_actor = 2;
    config.network.encoder = Encoder::Cnn;
    config.network.input_pool = 4;
    config.network.hidden = 32;
    config.episode.action_space = ActionSpace::Small;
    config.ppo.rollout_steps = 6;
    config.ppo.epochs = 2;
    config.ppo.learning_rate = 1e-3;
    config.ppo.environments_per_pass = 3;
    config
}

impl World {
    fn new(config: &Config) -> Self {
        let columns = config.environments();
        let steps = config.ppo.rollout_steps as usize;
        Self { columns, steps, planned: steps, previous: vec![NO_ACTION; columns] }
    }

    /// Acts through a rollout, in two halves a step; the last step has `last` columns.
    fn collect(&mut self, agent: &mut Agent, rollout: usize, last: usize) -> Result<Vec<StepOutput>, AgentError> {
        let Self { columns, steps, .. } = *self;
        let actions = 13;
        let frames = ((self.planned - 1) * columns + last) as u64;
        agent.begin_rollout(RolloutShape { steps: self.planned, environments_in_last_step: last, frames });
        let mut outputs = vec![];
        for t in 0..steps {
            let now = rollout * steps + t;
            let gumbel: Vec<f32> = noise(&format!("gumbel.{now}"), columns * actions)
                .into_iter()
                .map(|value| (-(-(value * 0.5 + 0.5).clamp(1e-6, 1.0 - 1e-6).ln()).ln()) as f32)
                .collect();
            let ended = noise(&format!("ended.{now}"), columns);
            let limit = noise(&format!("limit.{now}"), columns);
            let reward = noise_f32(&format!("reward.{now}"), columns);
            let disturbed = noise(&format!("disturbed.{now}"), columns);
            let mut whole = StepOutput::default();
            for half in [(0..columns / 2).collect::<Vec<_>>(), (columns / 2..columns).collect()] {
                let output = self.see(agent, now, &half, |agent, input| {
                    let gumbel = &gumbel[half[0] * actions..(half[half.len() - 1] + 1) * actions];
                    agent.step(t, &StepInput { gumbel, ..*input })
                })?;
                for (&n, &action) in half.iter().zip(&output.actions) {
                    if t + 1 < steps || n < last {
                        let ended = ended[n] > 0.5;
                        agent.record(
                            t,
                            n,
                            Outcome {
                                reward: reward[n] * 3.0,
                                ended,
                                time_limit: ended && limit[n] > 0.0,
                                disturbed: disturbed[n] > 0.4,
                            },
                        );
                        self.previous[n] = if ended { NO_ACTION } else { action };
                    }
                }
                whole.actions.extend(output.actions);
                whole.log_probs.extend(output.log_probs);
                whole.values.extend(output.values);
            }
            outputs.push(whole);
        }
        if self.planned > steps {
            agent.cut_rollout(steps);
        }
        let acting: Vec<usize> = (0..last).collect();
        self.see(agent, (rollout + 1) * steps, &acting, Agent::bootstrap)?;
        Ok(outputs)
    }

    fn see<T>(
        &self,
        agent: &mut Agent,
        now: usize,
        columns: &[usize],
        act: impl FnOnce(&mut Agent, &StepInput) -> T,
    ) -> T {
        let frames: Vec<Box<RawFrame>> = columns.iter().map(|&n| depth_mm(now, n)).collect();
        let frames: Vec<&RawFrame> = frames.iter().map(|frame| &**frame).collect();
        let goal_m: Vec<[f32; 3]> = columns.iter().map(|&n| goal_m(now, n)).collect();
        let previous_action: Vec<u8> = columns.iter().map(|&n| self.previous[n]).collect();
        let episode_start: Vec<bool> = previous_action.iter().map(|&action| action == NO_ACTION).collect();
        let input = StepInput {
            columns,
            frames: &frames,
            goal_m: &goal_m,
            previous_action: &previous_action,
            episode_start: &episode_start,
            gumbel: &[],
        };
        act(agent, &input)
    }
}

fn weights_of(agent: &Agent) -> BTreeMap<String, Tensor> {
    let weights = agent.state().tensors;
    weights.into_iter().filter_map(|(name, tensor)| Some((name.strip_prefix("model.")?.to_owned(), tensor))).collect()
}

/// Acting, advantages, losses, auxiliary task, passes, clipping, Adam and schedule together, over two rollouts.
#[test]
fn two_updates_are_those_of_the_reference() {
    let config = small_config();
    let mut agent = Agent::new(&config, Device::Cpu).expect("a fresh agent");
    let mut state = agent.state();
    for (name, tensor) in &mut state.tensors {
        if let Some(name) = name.strip_prefix("model.") {
            let scale = if name == "actor.weight" { 0.2 } else { 1.0 };
            *tensor = weight_values(name, &tensor.size()) * scale;
        }
    }
    agent.load_state(&state).expect("the state fits");

    let mut world = World::new(&config);
    let expected = fixture("run");
    for (rollout, (progress, last)) in [(0.0, 3), (0.5, 4)].into_iter().enumerate() {
        let outputs = world.collect(&mut agent, rollout, last).expect("finite");
        let metrics = agent.update(progress, rollout as u64).expect("finite");
        // Adam's first steps divide small gradients by themselves, which makes rounding a hundredth of a step: what
        // comes after them agrees to fewer digits.
        let tolerance = if rollout == 0 { 1e-5 } else { 1e-4 };
        let expected = |name: &str| &expected[&format!("{rollout}.{name}")];
        let join = |of: fn(&StepOutput) -> Vec<f32>| {
            Tensor::from_slice(&outputs.iter().flat_map(of).collect::<Vec<f32>>()).view([6, 4])
        };
        let actions = join(|output| output.actions.iter().map(|&action| f32::from(action)).collect());
        assert_close("actions", &actions, expected("actions"), 0.0);
        assert_close("log_probs", &join(|output| output.log_probs.clone()), expected("log_probs"), tolerance);
        assert_close("values", &join(|output| output.values.clone()), expected("values"), tolerance);
        let figures = [
            metric::POLICY_LOSS,
            metric::VALUE_LOSS,
            metric::ENTROPY,
            metric::AUXILIARY_LOSS,
            metric::CLIP_FRACTION,
            metric::APPROXIMATE_KL,
            metric::GRADIENT_NORM,
        ];
        for (name, theirs) in figures.iter().zip(doubles(expected("figures"))) {
            let ours = metrics[*name];
            // The policy loss and the divergence are differences of nearly equal numbers.
            assert!((ours - theirs).abs() < tolerance * theirs.abs().max(0.1), "{name}: {ours} is not {theirs}");
        }
        assert_probes(&weights_of(&agent), expected("weights"), 1e-4);
    }
}

// A batch from a file -----------------------------------------------------------------------------------------------

/// What `probe_batch` of the script makes: 7 steps of 4 columns, the last two of which have 6.
fn probe_batch(task: &str, actions: i64, hidden: i64) -> Vec<(&'static str, Tensor)> {
    let (steps, columns) = (7usize, 4usize);
    let size = [steps as i64, columns as i64];
    let cells: Vec<(usize, usize)> = (0..steps).flat_map(|t| (0..columns).map(move |n| (t, n))).collect();
    let table = |name: &str| noise_tensor(&format!("probe.{name}"), &size);
    let integers = |of: &dyn Fn(usize, usize) -> i64| {
        Tensor::from_slice(&cells.iter().map(|&(t, n)| of(t, n)).collect::<Vec<i64>>()).view(size)
    };
    let ended = table("ended").gt(0.6);
    let first = Tensor::from_slice(&[false, true, false, false]).view([1, 4]);
    let start = Tensor::cat(&[first, ended.narrow(0, 0, size[0] - 1)], 0);
    let previous = integers(&|t, n| 1 + (7 * t + n) as i64 % actions) * start.logical_not().to_kind(Kind::Int64);
    let frames: Vec<i16> = cells.iter().flat_map(|&(t, n)| depth_mm(t, n).map(|depth_mm| depth_mm as i16)).collect();
    let goals: Vec<f32> = cells.iter().flat_map(|&(t, n)| goal_m(t, n)).collect();
    let recorded = integers(&|t, n| i64::from(t + 1 < steps || n < 2));
    let mut batch = vec![
        ("frames", Tensor::from_slice(&frames).view([size[0], size[1], 224, 224])),
        ("goal_m", Tensor::from_slice(&goals).view([size[0], size[1], 3])),
        ("previous_action", previous),
        ("episode_start", start),
        ("action", integers(&|t, n| (3 * t + 5 * n + t * n) as i64 % actions)),
        ("log_prob", table("log_prob") * 0.5 - (actions as f64).ln()),
        ("value", table("value")),
        ("reward", table("reward") * 3.0),
        ("time_limit", ended.logical_and(&table("limit").gt(0.0))),
        ("ended", ended),
        ("disturbed", table("disturbed").gt(0.3)),
        ("bootstrap", noise_tensor("probe.bootstrap", &[size[1]])),
        ("beliefs", noise_tensor("probe.beliefs", &[size[1], hidden])),
        ("recorded", recorded.to_kind(Kind::Bool)),
    ];
    if task == "cpca16" {
        let valid = (cells.len() - 2) as i64;
        batch.push(("negatives", integers(&|t, n| (11 * (t * columns + n) as i64 + 5) % valid)));
    }
    batch
}

/// `learner probe`: every encoder and every auxiliary task, from files to a file, against the script's losses and
/// gradients.
#[test]
fn a_probe_finds_what_the_reference_finds() {
    let expected = fixture("probe");
    let folder = tempfile::tempdir().expect("a folder for the files");
    let path = |name: &str| folder.path().join(name);
    for (task, auxiliary, encoder, space, hidden, settings) in [
        ("disturb", AuxiliaryTask::Disturb, Encoder::Cnn, ActionSpace::Small, 32, "ppo.normalize_advantages = true\n"),
        ("cpca16", AuxiliaryTask::Cpca16, Encoder::Cnn, ActionSpace::Large, 24, "network.goal = \"cartesian\"\n"),
        ("inverse_dynamics", AuxiliaryTask::InverseDynamics, Encoder::Resnet, ActionSpace::Large, 48, ""),
    ] {
        let mut config = Config::default();
        config.network.encoder = encoder;
        config.network.input_pool = if encoder == Encoder::Cnn { 4 } else { 2 };
        config.network.previous_action = task != "cpca16";
        config.network.hidden = hidden;
        config.episode.action_space = space;
        config.auxiliary.task = auxiliary;
        let actions = space.actions().len() as i64;
        let (network, _) = Network::new(&config, Device::Cpu, |layout, hidden| {
            Auxiliary::new(&config.auxiliary, layout, hidden, actions)
        });
        let weights: Vec<(String, Tensor)> =
            network.parameters.named().map(|(name, w)| (name.to_owned(), weight_values(name, &w.size()))).collect();
        Tensor::write_safetensors(&weights, path("weights")).expect("weights are written");
        let batch = probe_batch(task, actions, i64::from(hidden));
        Tensor::write_safetensors(&batch, path("batch")).expect("a batch is written");
        std::fs::write(path("config"), format!("auxiliary.subsample = 1.0\n{settings}")).expect("settings");
        let run = Command::new(env!("CARGO_BIN_EXE_learner"))
            .args(["probe", "--weights", "weights", "--batch", "batch", "--out", "out", "--config", "config"])
            .current_dir(folder.path())
            .output()
            .expect("the learner starts");
        assert!(run.status.success(), "{task}: {run:?}");
        let found: BTreeMap<String, Tensor> =
            Tensor::read_safetensors(path("out")).expect("it is written").into_iter().collect();

        let expected = |name: &str| &expected[&format!("{task}.{name}")];
        for name in ["log_probs", "values", "advantages", "returns"] {
            assert_close(&format!("{task}: {name}"), &found[name], expected(name), 1e-5);
        }
        let figures = [
            metric::POLICY_LOSS,
            metric::VALUE_LOSS,
            metric::ENTROPY,
            metric::AUXILIARY_LOSS,
            metric::CLIP_FRACTION,
            metric::APPROXIMATE_KL,
            "loss/total",
            metric::GRADIENT_NORM,
        ];
        let printed = String::from_utf8(run.stdout).expect("text");
        for (name, theirs) in figures.iter().zip(doubles(expected("figures"))) {
            let ours = found[*name].double_value(&[]);
            assert!((ours - theirs).abs() < 1e-5 * theirs.abs().max(0.1), "{task}: {name}: {ours} is not {theirs}");
            assert!(printed.lines().any(|line| line == format!("{name} {ours}")), "{printed}");
        }
        let gradients: BTreeMap<String, Tensor> = found
            .iter()
            .filter_map(|(name, tensor)| Some((name.strip_prefix("gradient.")?.to_owned(), tensor.shallow_clone())))
            .collect();
        assert_probes(&gradients, expected("gradients"), 1e-5);
        if let Some((_, negatives)) = batch.iter().find(|(name, _)| *name == "negatives") {
            let shown = &found["auxiliary.negatives"];
            let asked = shown.ge(0);
            assert!(shown.masked_select(&asked).equal(&negatives.masked_select(&asked)));
        }
    }
}

#[test]
fn what_cannot_be_probed_is_named() {
    let config = small_config();
    let agent = Agent::new(&config, Device::Cpu).expect("a fresh agent");
    let folder = tempfile::tempdir().expect("a folder for the files");
    let path = |name: &str| folder.path().join(name);
    let weights: Vec<(String, Tensor)> = agent.state().tensors.into_iter().collect();
    let batch = || probe_batch("disturb", 13, 32);
    let said = |weights: &[(String, Tensor)], batch: &[(&str, Tensor)]| {
        Tensor::write_safetensors(weights, path("weights")).expect("weights are written");
        Tensor::write_safetensors(batch, path("batch")).expect("a batch is written");
        let run = Command::new(env!("CARGO_BIN_EXE_learner"))
            .args(["probe", "--weights", "weights", "--batch", "batch", "--out", "out"])
            .current_dir(folder.path())
            .output()
            .expect("the learner starts");
        (run.status.success(), String::from_utf8(run.stderr).expect("text"))
    };
    // An agent's state, as in a checkpoint: only what is its model counts.
    let (good, text) = said(&weights, &batch());
    assert!(good, "{text}");
    let (good, text) = said(&weights[1..], &batch());
    assert!(good, "moments are no weights: {text}");

    let change = |name: &str, tensor: Tensor| {
        let mut batch = batch();
        batch.retain(|(other, _)| *other != name);
        batch.push((Box::leak(name.to_owned().into_boxed_str()), tensor));
        batch
    };
    let cells = (Kind::Int64, Device::Cpu);
    for (batch, problem) in [
        (batch().into_iter().skip(1).collect(), "tensor `frames` is missing"),
        (change("action", Tensor::full([7, 4], 13, cells)), "`action` holds 13, outside 0..13"),
        (change("reward", Tensor::zeros([7, 3], (Kind::Float, Device::Cpu))), "`reward` has shape [7, 3], not [7, 4]"),
        (change("value", Tensor::zeros([7, 4], (Kind::Double, Device::Cpu))), "`value` is Double, not f32"),
        (change("recorded", Tensor::zeros([7, 4], (Kind::Bool, Device::Cpu))), "`recorded` may be false only for"),
        (change("frames", Tensor::zeros([7, 4, 100, 100], cells)), "`frames` has sides of 100 pixels"),
        (change("frames", Tensor::full([7, 4, 224, 224], -1, cells)), "whole millimetres from 0"),
        (change("goal", Tensor::zeros([7, 4, 3], (Kind::Float, Device::Cpu))), "only one can be meant"),
    ] {
        let (good, text) = said(&weights, &batch);
        assert!(!good && text.contains(problem) && text.contains("batch: "), "{problem}: {text}");
    }
    let mut fewer = weights.iter().map(|(name, weight)| (name.clone(), weight.shallow_clone())).collect::<Vec<_>>();
    fewer.retain(|(name, _)| name != "model.critic.bias");
    assert!(said(&fewer, &batch()).1.contains("weights: tensor `critic.bias` is missing"));
    fewer.push(("model.critic.bias".to_owned(), Tensor::zeros([1], (Kind::Float, Device::Cpu))));
    fewer.push(("model.other".to_owned(), Tensor::zeros([1], (Kind::Float, Device::Cpu))));
    assert!(said(&fewer, &batch()).1.contains("`other` has no place in this network"));
}

// Weights from elsewhere --------------------------------------------------------------------------------------------

/// A state dict of the script's `AllenAct`: names and shapes from its file, values from `set_weights`.
fn allenact(name: &str) -> BTreeMap<String, Tensor> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/reference/import_{name}.json"));
    let text = std::fs::read_to_string(path).expect("the list of names is committed");
    let shapes: BTreeMap<String, Vec<i64>> = serde_json::from_str(&text).expect("names and shapes");
    shapes.into_iter().map(|(name, shape)| (name.clone(), weight_values(&name, &shape))).collect()
}

fn configuration_of(name: &str) -> Config {
    let mut config = Config::default();
    config.actors.count = 1;
    config.network.hidden = 40;
    if name == "original" {
        config.network.hidden = 24;
        config.network.encoder = Encoder::Cnn;
        config.network.input_pool = 1;
        config.network.goal = GoalCoordinates::Cartesian;
        config.network.previous_action = false;
        config.episode.action_space = ActionSpace::Small;
        config.auxiliary.task = AuxiliaryTask::None;
    }
    config
}

/// A module under AllenAct's names, written in PyTorch, says the same as ours with its weights imported.
#[test]
fn an_imported_network_says_what_allenacts_says() {
    let expected = fixture("import");
    for name in ["disturb_free", "original"] {
        let config = configuration_of(name);
        let space = config.episode.action_space;
        let hidden = i64::from(config.network.hidden);
        let mut state = Agent::new(&config, Device::Cpu).expect("a fresh agent").state();
        let imported = import(&allenact(name), space, &mut state).expect("it is a state dict of this network");
        assert_eq!(imported.fresh, Vec::<String>::new());
        let tasks = |prefix: &str| imported.left_out.iter().filter(|name| name.starts_with(prefix)).count();
        let left_out = (tasks("auxiliary.inverse_dynamics."), tasks("auxiliary.cpca16."), imported.left_out.len());
        assert_eq!(left_out, if name == "original" { (0, 0, 0) } else { (2, 9, 11) });

        let (network, head) = Network::new(&config, Device::Cpu, |layout, hidden| {
            let actions = space.actions().len() as i64;
            (name != "original").then(|| Disturb::new(layout, [hidden, actions], 2.0))
        });
        tch::no_grad(|| {
            for (name, mut weight) in network.parameters.named() {
                weight.copy_(&state.tensors[&format!("model.{name}")]);
            }
        });
        let mut belief = noise_tensor("import.belief", &[2, hidden]);
        for t in 0..2i64 {
            let frames = [depth_mm(t as usize, 0), depth_mm(t as usize, 1)];
            let goals: Vec<f32> =
                (0..2).flat_map(|n| goal_coordinates(config.network.goal, goal_m(t as usize, n))).collect();
            let observations = Observations {
                frames: network.preparation.keep(&[&frames[0], &frames[1]], &mut Staging::default()),
                goals: Tensor::from_slice(&goals).view([2, 3]),
                // In the second column an episode begins: nothing came before.
                previous_actions: Tensor::from_slice(&[1 + 3 + t, 0]),
            };
            let before = belief * Tensor::from_slice(&[1f32, 0.0]).unsqueeze(1);
            belief = network.belief.step(&network.parameters, &network.embed(&observations), &before);
            let Judgement { log_probs, values } = network.judge(&belief);
            assert_close(name, &log_probs, &expected[&format!("{name}.log_probs")].get(t), 1e-5);
            assert_close(name, &values, &expected[&format!("{name}.values")].get(t), 1e-5);
        }
        if let Some(head) = head {
            assert_close("risk", &head.logits(&network.parameters, &belief), &expected["disturb_free.risk"], 1e-5);
        }
    }
}

#[test]
fn what_is_imported_and_what_is_refused() {
    let mut config = configuration_of("disturb_free");
    let space = config.episode.action_space;
    let state_dict = || allenact("disturb_free");

    // Another task's head.
    config.auxiliary.task = AuxiliaryTask::Cpca16;
    let agent = Agent::new(&config, Device::Cpu).expect("a fresh agent");
    let mut state = agent.state();
    import(&state_dict(), space, &mut state).expect("its head is there, too");
    let theirs = &state_dict()["aux_models.CPCA_16.action_embedder.fc.weight"];
    let ours = &state.tensors["model.auxiliary.cpca16.action_embedder.weight"];
    assert!(ours.equal(&theirs.narrow(0, 0, 21)) && theirs.size() == [22, 16]);
    let table = &state.tensors["model.previous_action_embedder.weight"];
    assert!(table.get(0).equal(&table.get(21)), "nothing before is as after Done");

    // A head that the file lacks starts as it would without it; a run of ours is taken as it is.
    let mut without = state_dict();
    without.retain(|name, _| !name.starts_with("aux_models."));
    let mut fresh = agent.state();
    let imported = import(&without, space, &mut fresh).expect("a head may be missing");
    assert_eq!(imported.fresh.len(), 9);
    let head = "model.auxiliary.cpca16.classifier.0.weight";
    assert!(fresh.tensors[head].equal(&agent.state().tensors[head]));
    let mut copy = agent.state();
    let imported = import(&state.tensors, space, &mut copy).expect("our own names");
    assert_eq!((imported.fresh.len(), imported.left_out.len()), (0, 0));
    assert!(state.tensors.iter().filter(|(name, _)| name.starts_with("model.")).all(|(n, w)| copy.tensors[n].equal(w)));

    let refused = |change: &dyn Fn(&mut BTreeMap<String, Tensor>)| {
        let mut state_dict = state_dict();
        change(&mut state_dict);
        import(&state_dict, space, &mut agent.state()).expect_err("it does not fit").to_string()
    };
    let zeros = |size: &[i64]| Tensor::zeros(size, (Kind::Float, Device::Cpu));
    let text = refused(&|dict| drop(dict.remove("critic.fc.bias")));
    assert!(text.contains("nothing is there for `critic.bias`"), "{text}");
    let text = refused(&|dict| drop(dict.remove("prev_action_embedder.fc.weight")));
    assert!(text.contains("network.previous_action = false"), "{text}");
    let text = refused(&|dict| drop(dict.insert("rgb_encoder.weight".into(), zeros(&[1]))));
    assert!(text.contains("`rgb_encoder.weight` is no weight of a network of ours"), "{text}");
    let text = refused(&|dict| drop(dict.insert("state_encoder.rnn.bias_hh_l0".into(), zeros(&[120]))));
    assert!(text.contains("twice"), "{text}");
    let text = refused(&|dict| drop(dict.insert("goal_embedder.0.0.weight".into(), zeros(&[100, 7]))));
    assert!(text.contains("`goal_embedder.0.weight` is [100, 7]; the configuration's network has [100, 3]"), "{text}");
    let text = refused(&|dict| drop(dict.insert("visual_encoder.depth_cnn.fc.bias".into(), zeros(&[512]))));
    assert!(text.contains("no place for `visual_encoder.cnn.6.bias`"), "{text}");
    let counts = Tensor::zeros([1], (Kind::Int64, Device::Cpu));
    let text = refused(&|dict| drop(dict.insert("critic.fc.bias".into(), counts.shallow_clone())));
    assert!(text.contains("floating-point"), "{text}");
}

// The same again ----------------------------------------------------------------------------------------------------

fn train(agent: &mut Agent, world: &mut World, rollouts: std::ops::Range<usize>) {
    for rollout in rollouts {
        world.collect(agent, rollout, if rollout == 1 { 2 } else { 4 }).expect("finite");
        agent.update(0.1 * rollout as f64, rollout as u64).expect("finite");
    }
}

#[test]
fn the_same_calls_give_the_same_bits_also_through_a_saved_state() {
    let config = small_config();
    let mut straight = Agent::new(&config, Device::Cpu).expect("a fresh agent");
    let mut world = World::new(&config);
    let fresh = straight.weights_digest();
    train(&mut straight, &mut world, 0..3);
    let digest = straight.weights_digest();
    assert_ne!(fresh, digest);

    let mut again = Agent::new(&config, Device::Cpu).expect("a fresh agent");
    assert_eq!(again.weights_digest(), fresh);
    train(&mut again, &mut World::new(&config), 0..3);
    assert_eq!(again.weights_digest(), digest);

    // Saved after the second rollout, loaded into an agent that has seen other things.
    let mut first = Agent::new(&config, Device::Cpu).expect("a fresh agent");
    let mut world = World::new(&config);
    train(&mut first, &mut world, 0..2);
    let previous = world.previous.clone();
    let state = first.state();
    let mut second = Agent::new(&Config { seed: 99, ..config.clone() }, Device::Cpu).expect("a fresh agent");
    train(&mut second, &mut World::new(&config), 0..1);
    assert_ne!(second.weights_digest(), first.weights_digest());
    // A state taken in the middle of a rollout is that of its beginning, and so is one after abandoning it.
    world.collect(&mut first, 2, 4).expect("finite");
    for (name, tensor) in &first.state().tensors {
        assert_eq!(to_vec(tensor), to_vec(&state.tensors[name]), "{name}");
    }
    first.abandon_rollout();
    world.previous.clone_from(&previous);
    train(&mut first, &mut world, 2..3);
    assert_eq!(first.weights_digest(), digest);
    second.load_state(&state).expect("the state fits");
    world.previous = previous;
    train(&mut second, &mut world, 2..3);
    assert_eq!(second.weights_digest(), digest);
    assert_eq!(second.state().adam_steps, 6);
}

#[test]
fn a_rollout_cut_short_trains_as_a_short_one() {
    let mut config = small_config();
    config.ppo.preemption_share = 0.6;
    let digest = |planned: usize| {
        let mut agent = Agent::new(&config, Device::Cpu).expect("a fresh agent");
        assert!(!agent.is_preempted(4, 6), "alone, nobody waits");
        let mut world = World { steps: 4, planned, ..World::new(&config) };
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
    agent.record(3, 1, Outcome { reward: f32::NAN, ended: false, time_limit: false, disturbed: false });
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
        let goal_m = [[0.0, f32::INFINITY, 0.0]];
        agent.step(0, &StepInput { goal_m: &goal_m, gumbel: &[0.0; 13], ..*input })
    });
    let error = error.expect_err("a goal is infinite");
    assert!(error.to_string().contains("column 2: goal sensor"), "{error}");
}

#[test]
fn states_that_do_not_fit_are_refused() {
    let config = small_config();
    let mut agent = Agent::new(&config, Device::Cpu).expect("a fresh agent");
    let digest = agent.weights_digest();
    let mut refuse = |change: &dyn Fn(&mut AgentState), word: &str| {
        let mut state = agent.state();
        for tensor in state.tensors.values_mut() {
            *tensor = &*tensor + 1.0;
        }
        change(&mut state);
        let error = agent.load_state(&state).expect_err(word).to_string();
        assert!(error.contains(word), "{error}");
        assert_eq!(agent.weights_digest(), digest);
    };
    let remove = |state: &mut AgentState| drop(state.tensors.remove("model.critic.bias"));
    refuse(&remove, "model.critic.bias is missing");
    let reshape = |state: &mut AgentState| {
        let beliefs = state.tensors["beliefs"].narrow(0, 0, 3);
        state.tensors.insert("beliefs".into(), beliefs);
    };
    refuse(&reshape, "beliefs is Float [3, 32]");
    let add = |state: &mut AgentState| drop(state.tensors.insert("model.x".into(), Tensor::from_slice(&[1f32])));
    refuse(&add, "no place for model.x");
}

/// Gradients of passes over parts of the columns add up to those of the whole batch.
#[test]
fn passes_add_up() {
    let train_with = |environments_per_pass: u32| {
        let mut config = small_config();
        config.ppo.environments_per_pass = environments_per_pass;
        config.ppo.epochs = 1;
        let mut agent = Agent::new(&config, Device::Cpu).expect("a fresh agent");
        let mut world = World::new(&config);
        world.collect(&mut agent, 0, 3).expect("finite");
        let metrics = agent.update(0.0, 0).expect("finite");
        // After one step Adam's first moment is a tenth of the gradient.
        (metrics, agent.state().tensors.remove("adam.first").expect("it is there"))
    };
    let (whole_metrics, whole) = train_with(0);
    for width in [1, 2, 3] {
        let (metrics, moment) = train_with(width);
        assert_eq!(metrics.keys().collect::<Vec<_>>(), whole_metrics.keys().collect::<Vec<_>>());
        for (name, value) in &metrics {
            assert!((value - whole_metrics[name]).abs() < 1e-5 * value.abs().max(0.1), "{name}");
        }
        assert_close("adam.first", &moment, &whole, 1e-5);
    }
}
