use super::frames::{self, Frames};
use super::gpu::{Monitor, Use};
use super::time::{percentile, synchronise};
use crate::agent::Agent;
use crate::ffi::profiler::profiled;
use crate::rollout::Outcome;
use anyhow::Result;
use proto::config::Config;
use proto::stage::RolloutShape;
use serde::Serialize;
use std::time::Instant;
use tch::Device;

const UPDATES: u64 = 3;
/// Updates before: in the first one libraries warm up, in the second one passes are recorded for all that follow.
const WARM_UPS: u64 = 2;

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Updates {
    pub steps: u32,
    pub environments: usize,
    pub frames: u64,
    pub epochs: u32,
    /// Time of one epoch, seconds: forward and backward pass of all frames, and the optimiser's step.
    pub epoch_s: f64,
    /// Time of a whole update, seconds: targets, all epochs, figures.
    pub update_s: f64,
    /// What the GPU did meanwhile: the agent's start and the collection of the rollouts included.
    pub gpu: Option<Use>,
}

/// Measures updates of rollouts of `steps` steps and about `frames` frames. With `mark` a profiler is shown one more, of
/// a single epoch.
pub fn measure(
    config: &Config,
    device: Device,
    steps: u32,
    frames: u32,
    monitor: &Monitor,
    mark: bool,
) -> Result<Updates> {
    let mut config = config.clone();
    config.ppo.rollout_steps = steps;
    frames::shape(&mut config, (frames / steps / 2).max(1));
    // Of two epochs at least: their difference to one is what another epoch takes.
    config.ppo.epochs = config.ppo.epochs.max(2);
    let epochs = config.ppo.epochs;
    let observations = Frames::new(&config)?;
    let (whole, gpu) = monitor.during(|| seconds(&config, device, &observations, false));
    config.ppo.epochs = 1;
    let (whole, one) = (whole?, seconds(&config, device, &observations, mark)?);
    let shape = shape(&config);
    Ok(Updates {
        steps,
        environments: config.environments(),
        frames: shape.frames,
        epochs,
        epoch_s: (whole - one) / f64::from(epochs - 1),
        update_s: whole,
        gpu,
    })
}

fn shape(config: &Config) -> RolloutShape {
    RolloutShape::next(u64::MAX, config.ppo.rollout_steps as usize, config.environments())
}

/// The median time of an update; with `mark` a profiler is shown one more.
fn seconds(config: &Config, device: Device, observations: &Frames, mark: bool) -> Result<f64> {
    let mut agent = Agent::new(config, device)?;
    let mut times = vec![];
    for number in 0..WARM_UPS + UPDATES {
        fill(&mut agent, config, observations)?;
        synchronise(device);
        let began = Instant::now();
        agent.update(0.0, number)?;
        synchronise(device);
        if number >= WARM_UPS {
            times.push(began.elapsed().as_secs_f64());
        }
    }
    if mark {
        fill(&mut agent, config, observations)?;
        synchronise(device);
        profiled(|| agent.update(0.0, WARM_UPS + UPDATES).map(|_| synchronise(device)))??;
    }
    times.sort_by(f64::total_cmp);
    Ok(percentile(&times, 0.5))
}

/// Collects a rollout: the network acts, rewards are made up.
fn fill(agent: &mut Agent, config: &Config, observations: &Frames) -> Result<()> {
    let shape = shape(config);
    agent.begin_rollout(shape);
    for t in 0..shape.steps {
        for half in 0..2 {
            agent.step(t, &observations.batch(half, t, observations.noise(half, t)).input())?;
        }
        for column in 0..config.environments() {
            let reward = ((t * 31 + column * 17) % 13) as f32 * 0.01 - 0.06;
            let ended = Frames::ends(column, t);
            agent.record(t, column, Outcome { reward, ended, label: (t + column) % 11 == 0, ..Outcome::default() });
        }
    }
    for half in 0..2 {
        agent.bootstrap(&observations.batch(half, shape.steps, vec![]).input())?;
    }
    Ok(())
}
