//! Any bytes as the tensors of a checkpoint whose manifest vouches for them: a state, or a reason why not.

use learner::checkpoint::read;
use proto::checkpoint::{Machine, Manifest};
use proto::config::CarriedGoal;
use proto::digest::sha256;

/// Whether they are a state that can be trained on.
pub fn take(bytes: &[u8]) -> bool {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let manifest = Manifest {
        schema_version: proto::SCHEMA_VERSION,
        run: String::new(),
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
        figures_sha256: String::new(),
        config_sha256: String::new(),
        config: String::new(),
        weights: String::new(),
        machine: Machine {
            torch: String::new(),
            device: String::new(),
            threads: 1,
            arithmetic: String::new(),
            learners: 1,
            shards: 0,
        },
        manifest_sha256: String::new(),
    };
    std::fs::write(folder.path().join("a.safetensors"), bytes).expect("the temporary folder has room");
    std::fs::write(folder.path().join("a.json"), manifest.seal()).expect("the temporary folder has room");
    let found = read(&folder.path().join("a.json"));
    match &found {
        Ok((snapshot, _)) => {
            let states = &snapshot.boundary.environments;
            assert!(states.iter().all(|state| state.actions().len() <= 512 && state.episode < u32::MAX));
        }
        Err(rejected) => assert!(!rejected.reason.is_empty()),
    }
    // The manifest is a file that somebody gave us, too.
    if let Err(problem) = Manifest::open(bytes) {
        assert!(!problem.to_string().is_empty());
    }
    found.is_ok()
}
