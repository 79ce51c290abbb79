//! Environments that are each in a kitchen of its own, beside as many in one: what it costs that they share nothing.

use super::action_source::PolicyKind;
use super::clock::seconds_per_call;
use super::memory;
use super::player::Player;
use super::visits;
use crate::parallel::in_parallel;
use anyhow::{Context, Result, ensure};
use proto::camera::FRAME_PIXELS;
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::kitchen::KitchenId;
use simulator::depth::{DepthCamera, Scenery};
use simulator::kitchen::Kitchen;
use simulator::source;
use std::io::Write;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Episodes that each environment plays over and over.
const EPISODES: u32 = 2;
/// Kitchens that are there before memory counts: the first fit into what making the others has freed.
const BEFORE: usize = 8;
/// Actions that each environment takes before its memory counts.
const STEPS: u32 = 50;

/// Measures and prints: as many environments as kitchens, each in its own, and all in one of them after the other.
pub(super) fn run(
    kitchens: &[KitchenId],
    policies: &[PolicyKind],
    seconds: f64,
    with_memory: bool,
    mut out: impl Write,
) -> Result<()> {
    ensure!(kitchens.len() > 1, "two kitchens at least: --kitchens 1000..1032");
    let config = Config::default();
    let folder = tempfile::tempdir().context("cannot make a temporary folder")?;
    let begun = Instant::now();
    let made = in_parallel(kitchens.len(), |index| source::keep_ready(kitchens[index], &config, folder.path()));
    made.into_iter().collect::<Result<Vec<bool>, _>>()?;
    let made_s = begun.elapsed().as_secs_f64();
    let begun = Instant::now();
    let mut opened = Vec::new();
    for &id in kitchens {
        opened.push(Arc::new(source::of_run(id, &config, folder.path())?));
    }
    let (count, opened_s) = (kitchens.len(), begun.elapsed().as_secs_f64());
    writeln!(
        out,
        "{count} kitchens: made in {made_s:.1} s on all processors, opened in {:.1} ms each",
        1000.0 * opened_s / count as f64
    )?;
    for &policy in policies {
        let apart = 1.0 / whole_step_s(&opened, policy, &config, seconds)?;
        let mut together_s = 0.0;
        for kitchen in &opened {
            let one = vec![Arc::clone(kitchen); count];
            together_s += whole_step_s(&one, policy, &config, seconds)? / count as f64;
        }
        let together = 1.0 / together_s;
        writeln!(
            out,
            "{:>7}: {count} environments, each in its own kitchen: {apart:.0} whole steps/s; all in one: {together:.0} \
             (mean over the kitchens); {:.0}%",
            policy.name(),
            100.0 * apart / together
        )?;
    }
    if kitchens.iter().all(|kitchen| kitchen.is_procedural()) {
        visits::run(kitchens, folder.path(), &mut out)?;
    }
    if with_memory {
        let mb = memory::environment_apart_mb(kitchens, folder.path())?;
        writeln!(out, "memory of a further environment with its own kitchen: {mb:.2} MB")?;
    }
    Ok(())
}

/// Processor time of a whole step of environments in these kitchens, each on the next in turn, seconds.
fn whole_step_s(kitchens: &[Arc<Kitchen>], policy: PolicyKind, config: &Config, seconds: f64) -> Result<f64> {
    let mut players = Vec::new();
    let mut sceneries: Vec<Scenery> = Vec::new();
    let mut scenery_of = Vec::new();
    for (number, kitchen) in (0..).zip(kitchens) {
        let id = EnvironmentId { kitchen: kitchen.id(), number };
        let mut player = Player::new(kitchen, id, config, policy, EPISODES)?;
        // In different phases of their episodes, as in a rollout.
        let phase = number as usize * player.episode_length() / kitchens.len();
        player.travel(phase, 1);
        players.push(player);
        // One camera, as in an actor; one scenery a kitchen.
        let known = kitchens[..number as usize].iter().position(|other| other.id() == kitchen.id());
        scenery_of.push(known.map_or(sceneries.len(), |known| scenery_of[known]));
        if known.is_none() {
            sceneries.push(Scenery::of(kitchen.bodies()));
        }
    }
    let mut camera = DepthCamera::new(&[]);
    let mut frame = vec![0; FRAME_PIXELS];
    let mut turn = 0;
    Ok(seconds_per_call(Duration::from_secs_f64(seconds), || {
        turn = (turn + 1) % players.len();
        players[turn].step();
        camera.exchange(&mut sceneries[scenery_of[turn]]);
        players[turn].look(&mut camera, &mut frame);
        camera.exchange(&mut sceneries[scenery_of[turn]]);
    }))
}

/// What the process that measures memory does: environments in kitchens that are kept in this folder, each with a scenery
/// and a kitchen of its own. Prints megabytes for each after the first [`BEFORE`].
pub fn print_memory(kitchens: &[KitchenId], folder: &Path) -> Result<()> {
    ensure!(kitchens.len() > BEFORE, "more than {BEFORE} kitchens are needed to measure memory");
    let config = Config::default();
    let mut frame = vec![0; FRAME_PIXELS];
    let mut environments = Vec::new();
    let mut camera = DepthCamera::new(&[]);
    let mut before = 0;
    for (number, &kitchen) in (0..).zip(kitchens) {
        if number as usize == BEFORE {
            before = memory::resident_bytes()?;
        }
        let built = Arc::new(source::of_run(kitchen, &config, folder)?);
        let mut scenery = Scenery::of(built.bodies());
        let mut player = Player::new(&built, EnvironmentId { kitchen, number }, &config, PolicyKind::Random, 1)?;
        for _ in 0..STEPS {
            player.step();
            camera.exchange(&mut scenery);
            player.look(&mut camera, &mut frame);
            camera.exchange(&mut scenery);
        }
        player.prepare();
        environments.push((player, scenery));
    }
    let further = (kitchens.len() - BEFORE) as f64;
    println!("{:.4}", (memory::resident_bytes()? as f64 - before as f64) / further / 1e6);
    drop(environments);
    Ok(())
}
