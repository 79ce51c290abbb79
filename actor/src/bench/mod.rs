//! `actor bench`: speed of one core.
//!
//! For each kitchen, policy and number of environments three figures: physics without frames, frames without physics
//! (drawn whole, from a new camera pose each), and whole steps as a rollout takes them, each on the next environment
//! in turn. The environments stand in different phases of their episodes, as in a rollout. Time is the thread's own
//! time on a processor, so that other programs of the machine do not count.

pub mod action_source;
mod clock;
pub mod player;
mod report;

use action_source::PolicyKind;
use anyhow::{Result, ensure};
use clock::seconds_per_call;
use player::{Player, View};
use proto::camera::{FRAME_PIXELS, FRAME_SIDE};
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::kitchen::KitchenChoice;
use report::Measurement;
use simulator::depth::DepthCamera;
use simulator::kitchen::Kitchen;
use std::hint::black_box;
use std::io::Write;
use std::sync::Arc;
use std::time::Duration;

const ENVIRONMENT_COUNTS: [u32; 3] = [1, 8, 32];
/// Episodes that are played over and over, of all environments together and of each at least.
const EPISODES: u32 = 8;
/// Views that frames without physics are drawn from, of all environments together.
const VIEWS: u32 = 64;

/// What to measure.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Kitchens: `all` 29, or numbers with commas between, or procedural ones, such as 1000..1032.
    #[arg(long, default_value = "all", value_name = "all|1,2,...")]
    kitchens: KitchenChoice,
    /// Who chooses the actions.
    #[arg(long, value_enum, value_delimiter = ',', default_values_t = PolicyKind::ALL, value_name = "POLICY,...")]
    policies: Vec<PolicyKind>,
    /// Seconds for each figure.
    #[arg(long, default_value_t = 0.2, value_name = "S")]
    seconds: f64,
    /// Print JSON, every kitchen by itself.
    #[arg(long)]
    json: bool,
}

pub fn run(arguments: &Arguments) -> Result<()> {
    ensure!(arguments.seconds > 0.0 && arguments.seconds <= 3600.0, "measure for a time between 0 and 3600 seconds");
    let config = Config::default();
    let mut rows = Vec::new();
    let kitchens = &arguments.kitchens.0;
    for &kitchen in kitchens {
        let built = Arc::new(Kitchen::build(kitchen, &config.simulation)?);
        for &policy in &arguments.policies {
            for environments in ENVIRONMENT_COUNTS {
                rows.push(measure(&built, policy, environments, &config, arguments.seconds)?);
            }
        }
        tracing::info!("kitchen {kitchen} measured");
    }
    let mut out = std::io::stdout().lock();
    if arguments.json {
        writeln!(out, "{:#}", report::json(&rows))?;
    } else {
        writeln!(
            out,
            "median of {} kitchens; {} sub-steps of {:.4} s a step; {FRAME_SIDE}×{FRAME_SIDE} pixels; one thread",
            kitchens.len(),
            config.simulation.substeps,
            config.simulation.timestep_s,
        )?;
        report::table(&mut out, &rows)?;
    }
    Ok(())
}

fn measure(
    kitchen: &Arc<Kitchen>,
    policy: PolicyKind,
    environments: u32,
    config: &Config,
    seconds: f64,
) -> Result<Measurement> {
    let span = Duration::from_secs_f64(seconds);
    let mut camera = DepthCamera::new(kitchen.bodies());
    let mut frame = vec![0; FRAME_PIXELS];
    let mut players = Vec::new();
    let mut views: Vec<View> = Vec::new();
    for number in 0..environments {
        let id = EnvironmentId { kitchen: kitchen.id(), number };
        let mut player = Player::new(kitchen, id, config, policy, EPISODES.div_ceil(environments))?;
        // One after the other through the episode; a lone one goes through it all, for its views.
        let length = player.episode_length();
        let phase = if environments == 1 { length } else { number as usize * length / environments as usize };
        views.extend(player.travel(phase, VIEWS.div_ceil(environments) as usize));
        players.push(player);
    }

    let mut turn = 0;
    let mut next = || {
        turn = (turn + 1) % environments as usize;
        turn
    };
    let physics_s = seconds_per_call(span, || players[next()].step());

    let (mut frames, mut view_set) = (0usize, 0);
    let depth_s = seconds_per_call(span, || {
        let view = &views[frames % views.len()];
        camera.render(&view.world_from_bodies, view.world_from_camera, FRAME_SIDE, &mut frame);
        frames += 1;
        view_set += camera.view_set_triangles();
        black_box(&frame);
    });

    let mut depth_mm = vec![0; FRAME_PIXELS];
    let whole_step_s = seconds_per_call(span, || {
        let player = &mut players[next()];
        player.step();
        player.look(&mut camera, &mut depth_mm);
    });
    Ok(Measurement {
        kitchen: kitchen.id(),
        policy,
        environments,
        physics_s,
        depth_s,
        whole_step_s,
        view_set_triangles: view_set as f64 / frames as f64,
    })
}
