//! Memory of a further environment, measured in a process that does nothing else.

use super::action_source::PolicyKind;
use super::player::Player;
use anyhow::{Context, Result, ensure};
use proto::camera::FRAME_PIXELS;
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::kitchen::{KitchenChoice, KitchenId};
use simulator::depth::DepthCamera;
use simulator::kitchen::Kitchen;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;

/// Environments before and after. The first ones fit into what building the kitchen has freed, and would look free.
const COUNTS: [u32; 2] = [32, 64];
/// Actions that each environment takes before its memory counts: buffers grow to their size in use.
const STEPS: u32 = 50;

/// Asks a fresh process of this program: megabytes (10⁶ bytes) of resident memory for each further environment.
pub(crate) fn further_environment_mb(kitchen: KitchenId) -> Result<f64> {
    ask(&["--kitchens", &kitchen.to_string()])
}

/// The same for each further environment that has a kitchen of its own, kept in this folder.
pub(super) fn environment_apart_mb(kitchens: &[KitchenId], folder: &Path) -> Result<f64> {
    let folder = folder.to_str().context("the temporary folder has a name that is not text")?;
    ask(&["--kitchens", &KitchenChoice(kitchens.to_vec()).to_string(), "--apart", folder])
}

fn ask(arguments: &[&str]) -> Result<f64> {
    let program = std::env::current_exe().context("cannot find this program's own file")?;
    let output = Command::new(program)
        .arg("bench-memory")
        .args(arguments)
        .stderr(std::process::Stdio::inherit())
        .output()
        .context("cannot start this program again to measure its memory")?;
    ensure!(output.status.success(), "the process that measures memory failed: {}", output.status);
    let text = String::from_utf8_lossy(&output.stdout);
    text.trim().parse().with_context(|| format!("the process that measures memory printed {text:?}"))
}

/// What that process does: prints its figure.
pub fn run(kitchen: KitchenId) -> Result<()> {
    let config = Config::default();
    let built = Arc::new(Kitchen::build(kitchen, &config.simulation)?);
    let mut camera = DepthCamera::new(built.bodies());
    let mut frame = vec![0; FRAME_PIXELS];
    let mut players: Vec<Player> = Vec::new();
    let mut resident = Vec::new();
    for count in COUNTS {
        for number in players.len() as u32..count {
            let mut player = Player::new(&built, EnvironmentId { kitchen, number }, &config, PolicyKind::Random, 1)?;
            for _ in 0..STEPS {
                player.step();
                player.look(&mut camera, &mut frame);
            }
            player.prepare();
            players.push(player);
        }
        resident.push(resident_bytes()?);
    }
    let further = f64::from(COUNTS[1] - COUNTS[0]);
    println!("{:.4}", (resident[1] as f64 - resident[0] as f64) / further / 1e6);
    Ok(())
}

/// Resident memory of this process.
pub(super) fn resident_bytes() -> Result<u64> {
    let text = std::fs::read_to_string("/proc/self/status").context("cannot read /proc/self/status")?;
    let kib: u64 = text
        .lines()
        .find_map(|line| line.strip_prefix("VmRSS:"))
        .and_then(|rest| rest.trim().strip_suffix("kB"))
        .and_then(|number| number.trim().parse().ok())
        .context("/proc/self/status holds no VmRSS")?;
    Ok(kib * 1024)
}

#[cfg(test)]
mod tests {
    #[test]
    fn resident_memory_grows_by_what_is_written() {
        let before = super::resident_bytes().unwrap();
        let block = vec![1u8; 64 << 20];
        let grown = super::resident_bytes().unwrap() - before;
        assert!(std::hint::black_box(&block).len() == 64 << 20);
        assert!(grown > 50 << 20, "{grown}");
    }
}
