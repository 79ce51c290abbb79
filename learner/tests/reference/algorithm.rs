//! What the update is made of: targets, losses, optimiser, multiplier, sensors.

use crate::shared::{assert_close, choice, doubles, fixture, noise, noise_f32, noise_tensor};
use crate::world::small_config;
use learner::agent::Agent;
use learner::auxiliary::focal_loss;
use learner::collector::{Ended, RolloutStatistics, RunningEpisode};
use learner::network::{ActorCriticOutput, Kept, goal_coordinates};
use learner::optimizer::{Adam, clip, norm};
use learner::peers::Peers;
use learner::ppo::gae;
use learner::ppo::loss::{Experience, terms};
use learner::ppo::moments::RewardScale;
use learner::rollout::{Outcome, Rollout, Step};
use learner::shards::Shards;
use proto::config::{GoalCoordinates, LagrangianConfig, PpoConfig};
use proto::learning_rate::falling;
use proto::stage::RolloutShape;
use tch::{Device, Kind, Tensor};

#[test]
fn advantages_are_the_explicit_sums() {
    let (steps, columns) = (12, 5);
    let float = (Kind::Float, Device::Cpu);
    let shape = RolloutShape { steps, environments_in_last_step: 3, frames: 58 };
    let kept = |rows: i64| Kept::of_frames(Tensor::zeros([rows, 1, 1], float));
    let mut rollout = Rollout::new(shape, columns, kept(60), Tensor::zeros([5, 1], float));
    let all = [0, 1, 2, 3, 4];
    let table = |name: &str| noise_f32(name, steps * columns);
    let (rewards, values) = (table("gae.reward"), table("gae.value"));
    let (ended, limit) = (noise("gae.ended", steps * columns), noise("gae.limit", steps * columns));
    for t in 0..steps {
        let rows = all.map(|n| Step { value: 2.0 * values[t * columns + n], ..Step::default() });
        rollout.store(t, &all, &kept(5), &rows);
        for n in all.into_iter().filter(|&n| t + 1 < steps || n < 3) {
            let index = t * columns + n;
            let ended = ended[index] > 0.6;
            let time_limit = ended && limit[index] > 0.0;
            rollout.record(t, n, Outcome { reward: rewards[index], ended, time_limit, ..Outcome::default() });
        }
    }
    for (n, value) in noise_f32("gae.after", columns).into_iter().enumerate().take(3) {
        rollout.set_bootstrap(n, value);
    }
    let expected = fixture("gae");
    for (name, bootstrap_time_limits) in [("terminal", false), ("truncated", true)] {
        for (figure, normalize_advantages) in [("advantages", false), ("normalized", true)] {
            let ppo = proto::config::PpoConfig { bootstrap_time_limits, normalize_advantages, ..Default::default() };
            let targets =
                gae::estimate(&rollout, &ppo, RewardScale::NONE, &Shards::one(rollout.columns()), &Peers::Alone)
                    .expect("nobody to lose");
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

/// `collect_rollouts` of Stable-Baselines3 adds the discounted value of a truncated episode's last observation to its
/// last reward, and `compute_returns_and_advantage` knows ends alone.
#[test]
fn truncated_episodes_are_bootstrapped_as_by_stable_baselines() {
    let (steps, columns) = (40, 3);
    let float = (Kind::Float, Device::Cpu);
    let shape = RolloutShape::next(u64::MAX, steps, columns);
    let kept = |rows: i64| Kept::of_frames(Tensor::zeros([rows, 0, 0], float));
    let mut rollout = Rollout::new(shape, columns, kept(120), Tensor::zeros([3, 0], float));
    let table = |name: &str| noise_f32(&format!("sb3.{name}"), steps * columns);
    let [mut rewards, values, last, ended, limit] = ["reward", "value", "last", "ended", "limit"].map(table);
    let after = noise_f32("sb3.after", columns);
    let dones: Vec<bool> = ended.iter().map(|&number| number > 0.5).collect();
    let truncated = |row: usize| dones[row] && limit[row] > 0.0;
    for t in 0..steps {
        let rows = [0, 1, 2].map(|n| Step { value: values[t * columns + n], ..Step::default() });
        rollout.store(t, &[0, 1, 2], &kept(3), &rows);
        for n in 0..columns {
            let row = t * columns + n;
            let (reward, time_limit) = (rewards[row], truncated(row));
            rollout.record(t, n, Outcome { reward, ended: dones[row], time_limit, ..Outcome::default() });
            if time_limit {
                rollout.set_last_value(t, n, last[row]);
            }
        }
    }
    (0..columns).for_each(|n| rollout.set_bootstrap(n, after[n]));
    let ppo = PpoConfig { bootstrap_time_limits: true, ..PpoConfig::default() };
    let targets =
        gae::estimate(&rollout, &ppo, RewardScale::NONE, &Shards::one(columns), &Peers::Alone).expect("nobody to lose");

    for row in (0..steps * columns).filter(|&row| truncated(row)) {
        rewards[row] += 0.99 * last[row];
    }
    let mut last_gae_lam = vec![0.0; columns];
    for row in (0..steps * columns).rev() {
        let (t, n) = (row / columns, row % columns);
        // episode_starts[t + 1], or dones of the last step.
        let next_non_terminal = if dones[row] { 0.0 } else { 1.0 };
        let next_value = if t == steps - 1 { after[n] } else { values[row + columns] };
        let delta = rewards[row] + 0.99 * next_value * next_non_terminal - values[row];
        last_gae_lam[n] = delta + 0.99 * 0.95 * next_non_terminal * last_gae_lam[n];
        let found = [targets.advantage((t, n)), targets.value_target((t, n))];
        for (ours, theirs) in found.into_iter().zip([last_gae_lam[n], last_gae_lam[n] + values[row]]) {
            assert!((ours - theirs).abs() < 1e-5, "({t}, {n}): {ours} is not {theirs}");
        }
    }
    assert!((0..steps * columns).any(truncated) && (0..steps * columns).any(|row| dones[row] && !truncated(row)));
}

#[test]
fn the_losses_and_their_gradients_are_the_formulas() {
    let rows = 40;
    let expected = fixture("loss");
    let logits = (noise_tensor("loss.logits", &[rows, 21]) * 2.0).set_requires_grad(true);
    let values = noise_tensor("loss.values", &[rows]).set_requires_grad(true);
    let experience = Experience {
        actions: Tensor::from_slice(&(0..rows).map(|i| (7 * i) % 21).collect::<Vec<_>>()).view([rows, 1]),
        masks: None,
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
        let output = ActorCriticOutput { policy: choice(cut(&logits).log_softmax(-1, None)), values: cut(&values) };
        let part = Experience {
            actions: cut(&experience.actions),
            masks: None,
            log_probs: cut(&experience.log_probs),
            values: cut(&experience.values),
            advantages: cut(&experience.advantages),
            returns: cut(&experience.returns),
        };
        let terms = terms(&output, &part, &PpoConfig::default(), rows as u64);
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
        let norm = norm(&gradient);
        clip(&mut gradient, &norm, 0.5);
        let theirs = expected["norms"].double_value(&[update]);
        let norm = norm.double_value(&[]);
        assert!((norm - theirs).abs() < 1e-5 * theirs, "update {update}: norm {norm} is not {theirs}");
        adam.step(&mut weights, &gradient, falling(3e-2, 1.0 / 3.0, update as f64 / updates as f64), 1e-8);
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
    let mut running: [(u32, RunningEpisode); 3] = std::array::from_fn(|_| (0, RunningEpisode::default()));
    let mut trace = vec![];
    for rollout in 0..rollouts {
        let mut statistics = RolloutStatistics::of(config.spec());
        for t in 0..steps {
            for (n, (step, episode)) in running.iter_mut().enumerate() {
                let cell = (rollout * steps + t) * columns + n;
                // The part is progress, its cost the other way round.
                episode.add(*step, 0.0, -progress[cell], 0.99);
                *step += 1;
                if ended[cell] > 0.75 && rollout != 3 {
                    statistics.add_episode(&Ended { length: *step, running: std::mem::take(episode) });
                    *step = 0;
                }
            }
        }
        agent.constrain(statistics.mean_discounted_cost());
        trace.push(agent.multiplier());
    }
    assert_close("multiplier", &Tensor::from_slice(&trace), &fixture("lagrangian")["trace"], 1e-12);
    let saved = agent.state();
    agent.start_stage();
    assert_eq!(agent.multiplier(), 0.01, "a stage begins anew");
    agent.load_state(&saved).expect("the state fits");
    assert_eq!(agent.multiplier(), trace[rollouts - 1]);
}
