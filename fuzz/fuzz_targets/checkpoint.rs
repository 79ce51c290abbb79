//! Any bytes as the tensors of a checkpoint whose manifest vouches for them.
#![no_main]

use learner::checkpoint::read;
use libfuzzer_sys::fuzz_target;
use proto::checkpoint::{Machine, Manifest};
use proto::config::CarriedGoal;
use proto::digest::sha256;
use std::path::PathBuf;
use std::sync::LazyLock;

static FOLDER: LazyLock<PathBuf> = LazyLock::new(|| tempfile::tempdir().unwrap().keep());

fuzz_target!(|bytes: &[u8]| {
    let manifest = Manifest {
        schema_version: proto::SCHEMA_VERSION,
        rollout: 1,
        frames: 8,
        exchange: 4,
        stage: 0,
        stage_end: false,
        adam_steps: 1,
        multiplier: 0.0,
        carried_goal: CarriedGoal::GoalToObject,
        tensors: "a.safetensors".into(),
        tensors_bytes: bytes.len() as u64,
        tensors_sha256: sha256(bytes),
        config_sha256: String::new(),
        config: String::new(),
        weights: String::new(),
        machine: Machine {
            torch: String::new(),
            device: String::new(),
            threads: 1,
            arithmetic: String::new(),
            learners: 1,
        },
        manifest_sha256: String::new(),
    };
    std::fs::write(FOLDER.join("a.safetensors"), bytes).unwrap();
    std::fs::write(FOLDER.join("a.json"), manifest.seal()).unwrap();
    match read(&FOLDER.join("a.json")) {
        Ok((snapshot, _)) => {
            let states = &snapshot.boundary.environments;
            assert!(states.iter().all(|state| state.actions().len() <= 512 && state.episode < u32::MAX));
        }
        Err(rejected) => assert!(!rejected.reason.is_empty()),
    }
});
