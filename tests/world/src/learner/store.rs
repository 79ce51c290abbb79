//! The real store of checkpoints on the world's disk.

use crate::disk::SimulatedDisk;
use crate::kernel::World;
use learner::checkpoint::Store;
use proto::checkpoint::Machine;
use proto::disk::Disk;
use proto::run_folder::{RolloutName, RunFolder};

/// The run's folder on the world's disk.
const RUN: &str = "run";
/// What stands for the configuration in manifests.
const CONFIG: &str = "preset = \"world\"";

/// Tears the newest checkpoint; false where there is no older one.
pub fn tear_newest(world: &mut World) -> bool {
    let run = RunFolder::new(RUN);
    let names = world.disk.list(&run.checkpoints()).unwrap_or_default();
    let mut rollouts: Vec<u64> = names.iter().filter_map(|path| RolloutName::Manifest.rollout_of(path)).collect();
    rollouts.sort_unstable();
    let [.., _, newest] = rollouts[..] else { return false };
    let path = if world.dice.once_in(2) { run.checkpoint_manifest(newest) } else { run.checkpoint_tensors(newest) };
    world.saved = None;
    let disk = world.disk.clone();
    disk.tear(&path, &mut world.dice)
}

/// The store of a world's checkpoints.
pub(super) fn store_of(world: &World) -> Store<SimulatedDisk> {
    let config = &world.setup.config;
    let machine = Machine {
        torch: "none".to_owned(),
        device: "cpu".to_owned(),
        threads: 1,
        arithmetic: "reproducible".to_owned(),
        learners: config.learner.count,
        shards: config.learner.shards,
    };
    let store = Store::new((RunFolder::new(RUN), ""), &config.stages, CONFIG, machine, config.checkpoint.keep);
    store.on(world.disk.clone())
}
