//! `actor bench`: what one core does, measured in place.
//!
//! Three figures for 1, 8 and 32 environments of one kitchen in turn: physics without frames, frames without physics,
//! and whole steps as a rollout takes them. The policy is random, without Done, so that episodes last. Time is the
//! thread's own time on a processor, so that other programs of the machine do not count.

use crate::depth::DepthCamera;
use crate::environment::Environment;
use crate::kitchen::Kitchen;
use anyhow::{Context, Result, ensure};
use proto::action::{Action, ActionSpace};
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::kitchen::KitchenId;
use proto::message::{FRAME_PIXELS, FRAME_SIDE, transition_flag};
use proto::random::{Key, Purpose};
use std::io::Write;
use std::sync::Arc;
use std::time::{Duration, Instant};

const ENVIRONMENT_COUNTS: [u32; 3] = [1, 8, 32];
const CALLS_PER_LOOK: usize = 64;

/// Measures in `kitchen`, about `seconds` for each figure, and prints a table.
pub fn run(kitchen: KitchenId, seconds: f64) -> Result<()> {
    ensure!(seconds > 0.0 && seconds <= 3600.0, "measure for a time between 0 and 3600 seconds");
    let span = Duration::from_secs_f64(seconds);
    let config = Config::default();
    let started = Instant::now();
    let built = Arc::new(Kitchen::build(kitchen, &config.simulation)?);
    let build_ms = started.elapsed().as_secs_f64() * 1e3;
    let mut camera = DepthCamera::new(built.bodies());
    let mut out = std::io::stdout().lock();
    writeln!(
        out,
        "kitchen {kitchen}: {} bodies, {} triangles, built in {build_ms:.0} ms; {} sub-steps a step; one thread",
        built.bodies().len(),
        camera.triangles(),
        config.simulation.substeps
    )?;
    writeln!(
        out,
        "{:>12}  {:>22}  {:>22}  {:>22}  {:>17}",
        "environments", "physics", "depth", "whole step", "view set triangles"
    )?;
    for count in ENVIRONMENT_COUNTS {
        let mut players = (0..count)
            .map(|number| Player::new(&built, EnvironmentId { kitchen, number }, &config))
            .collect::<Result<Vec<_>>>()?;
        let mut poses = Vec::new();
        let mut frame = vec![0; FRAME_PIXELS];
        let (mut looks, mut triangles) = (0, 0);
        let mut look = |player: &Player| {
            player.environment.world_from_bodies(&mut poses);
            camera.render(&poses, player.environment.world_from_camera(), FRAME_SIDE, &mut frame);
            looks += 1;
            triangles += camera.view_set_triangles();
        };
        let physics = rate(&mut players, span, Player::step)?;
        let depth = rate(&mut players, span, |player| look(player))?;
        let whole = rate(&mut players, span, |player| {
            player.step();
            look(player);
        })?;
        let cell = |per_s: f64| format!("{:>8.1} µs {per_s:>8.0} /s", 1e6 / per_s);
        let (physics, depth, whole) = (cell(physics), cell(depth), cell(whole));
        writeln!(out, "{count:>12}  {physics:>22}  {depth:>22}  {whole:>22}  {:>17}", triangles / looks.max(1))?;
    }
    Ok(())
}

/// One environment under a random policy.
struct Player {
    id: EnvironmentId,
    environment: Environment,
    episode: u32,
    step: u32,
}

impl Player {
    fn new(kitchen: &Arc<Kitchen>, id: EnvironmentId, config: &Config) -> Result<Self> {
        let environment = Environment::new(Arc::clone(kitchen), id, config)?;
        Ok(Self { id, environment, episode: 0, step: 0 })
    }

    fn step(&mut self) {
        let key = Key {
            seed: 1,
            purpose: Purpose::RandomPolicy,
            kitchen: self.id.kitchen.number(),
            environment: self.id.number,
            episode: self.episode,
            step: self.step,
        };
        let actions = ActionSpace::Large.actions();
        let lasting = actions.iter().filter(|&&action| action != Action::DoneMidLevel).count();
        let action = actions[key.stream().below(lasting as u32) as usize];
        assert!(action != Action::DoneMidLevel, "Done is the last of all actions");
        self.step += 1;
        if self.environment.step(action).flags & transition_flag::ENDED != 0 {
            self.episode += 1;
            self.step = 0;
            self.environment.start_episode(self.episode);
        }
    }
}

/// Calls a second, each on the next environment in turn.
fn rate(players: &mut [Player], span: Duration, mut call: impl FnMut(&mut Player)) -> Result<f64> {
    // Once round for caches and episodes' first steps.
    players.iter_mut().for_each(&mut call);
    let started = processor_time()?;
    let mut calls = 0usize;
    loop {
        // The clock is a file: not to be looked at for each call.
        for _ in 0..CALLS_PER_LOOK.div_ceil(players.len()) {
            players.iter_mut().for_each(&mut call);
            calls += players.len();
        }
        let elapsed = processor_time()?.saturating_sub(started);
        if elapsed >= span {
            return Ok(calls as f64 / elapsed.as_secs_f64());
        }
    }
}

/// Time that the main thread has spent on a processor: the first field of `/proc/self/schedstat`, nanoseconds.
fn processor_time() -> Result<Duration> {
    let text = std::fs::read_to_string("/proc/self/schedstat").context("cannot read /proc/self/schedstat")?;
    let ns =
        text.split_whitespace().next().and_then(|field| field.parse().ok()).context("/proc/self/schedstat is empty")?;
    Ok(Duration::from_nanos(ns))
}
