//! One step of a half of the environments: frames in shared memory → sampled actions. As in a run, noise was drawn
//! before the last observation arrived, and is not in it.

use super::frames::{Frames, shape};
use super::gpu::{Monitor, Use};
use super::time::percentile;
use crate::agent::Agent;
use crate::ffi::profiler::profiled;
use crate::network::{FramePreparation, Staging};
use anyhow::Result;
use proto::config::Config;
use proto::stage::RolloutShape;
use serde::Serialize;
use std::time::{Duration, Instant};
use tch::Device;

const STEPS: usize = 16;
const FEWEST: usize = 20;

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Inference {
    pub batch: u32,
    pub p50_s: f64,
    pub p99_s: f64,
    /// Median time from shared memory to kept frames, seconds: a part of the step. None in a task without a frame, and on a
    /// GPU, which reads the frames itself, or waits for their copy if a warning says so.
    pub copy_s: Option<f64>,
    pub gpu: Option<Use>,
}

/// Measures for `span` at least. With `mark` a profiler is shown one more step.
pub fn measure(
    config: &Config,
    device: Device,
    batch: u32,
    span: Duration,
    monitor: &Monitor,
    mark: bool,
) -> Result<Inference> {
    let mut config = config.clone();
    shape(&mut config, batch);
    config.ppo.rollout_steps = STEPS as u32;
    let frames = Frames::new(&config)?;
    let mut agent = Agent::new(&config, device)?;
    // Kernels are chosen and memory is taken.
    rollout(&mut agent, &frames, &config, &mut vec![])?;
    let mut times = vec![];
    let (done, gpu) = monitor.during(|| -> Result<()> {
        let began = Instant::now();
        while times.len() < FEWEST || began.elapsed() < span {
            rollout(&mut agent, &frames, &config, &mut times)?;
        }
        Ok(())
    });
    done?;
    if mark {
        agent.begin_rollout(RolloutShape::next(u64::MAX, STEPS, config.environments()));
        profiled(|| agent.step(0, &frames.batch(0, 0, frames.noise(0, 0)).input()))??;
    }
    times.sort_by(f64::total_cmp);
    let has_frames = config.spec().inputs()?.frame.is_some();
    let copy_s = (device == Device::Cpu && has_frames).then(|| copy(&frames, &config));
    Ok(Inference { batch, p50_s: percentile(&times, 0.5), p99_s: percentile(&times, 0.99), copy_s, gpu })
}

fn rollout(agent: &mut Agent, frames: &Frames, config: &Config, times: &mut Vec<f64>) -> Result<()> {
    agent.begin_rollout(RolloutShape::next(u64::MAX, STEPS, config.environments()));
    for t in 0..STEPS {
        for half in 0..2 {
            let noise = frames.noise(half, t);
            let began = Instant::now();
            agent.step(t, &frames.batch(half, t, noise).input())?;
            times.push(began.elapsed().as_secs_f64());
        }
    }
    agent.abandon_rollout();
    Ok(())
}

fn copy(frames: &Frames, config: &Config) -> f64 {
    let preparation = FramePreparation::of(config, Device::Cpu);
    let mut staging = Staging::default();
    let batches = [0, 1].map(|half| frames.batch(half, 0, vec![]));
    let mut times: Vec<f64> = (0..2 * FEWEST)
        .map(|turn| {
            let began = Instant::now();
            let kept = preparation.keep(&batches[turn % 2].frames, &mut staging);
            drop(kept);
            began.elapsed().as_secs_f64()
        })
        .collect();
    times.sort_by(f64::total_cmp);
    percentile(&times, 0.5)
}
