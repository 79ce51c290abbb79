//! Advantages, multiplier, sensors. Losses are compared in `probe.rs` and `numbers.rs`, the optimiser in `whole.rs`.

use crate::shared::{assert_close, doubles, fixture, noise, noise_f32};
use crate::world::small_config;
use learner::agent::Agent;
use learner::collector::{Ended, RolloutStatistics, RunningEpisode};
use learner::network::{Kept, goal_coordinates};
use learner::peers::Peers;
use learner::ppo::gae;
use learner::ppo::moments::RewardScale;
use learner::rollout::{Outcome, Rollout, Step};
use learner::shards::Shards;
use proto::config::{GoalCoordinates, LagrangianConfig};
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
