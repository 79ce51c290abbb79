//! Any bytes as each file that a checkpoint or a policy comes in: as tensors that a manifest vouches for, as a manifest,
//! as figures, as a policy file, as weights to import. Each is read, or there is a reason why not.

use learner::agent::AgentState;
use learner::checkpoint::{decode_tensors, read};
use learner::import::import;
use learner::process::facts_of;
use proto::checkpoint::{Machine, Manifest};
use proto::config::CarriedGoal;
use proto::digest::sha256;
use proto::trained::History;
use tch::{Device, Kind, Tensor};

/// Whether one of the readers takes them.
pub fn take(bytes: &[u8]) -> bool {
    let (figures, _) = History::decode(bytes);
    assert_eq!(History::decode(&figures.encode()).1, 0, "what was read can be written");
    let taken = [is_state(bytes), said(Manifest::open(bytes)), is_policy(bytes), is_weights(bytes)];
    taken.contains(&true)
}

/// Whether it is there. If not, the reason has words.
fn said<T, E: ToString>(found: Result<T, E>) -> bool {
    found.map_err(|problem| assert!(!problem.to_string().is_empty())).is_ok()
}

fn is_policy(bytes: &[u8]) -> bool {
    match facts_of(bytes) {
        Ok(facts) => facts.is_some(),
        problem => said(problem),
    }
}

/// Whether they have a place in a small network.
fn is_weights(bytes: &[u8]) -> bool {
    let shapes = [("model.actor.weight", [2, 3]), ("model.previous_action_embedder.weight", [22, 1])];
    let place = |(name, shape): (&str, [i64; 2])| (name.to_owned(), Tensor::zeros(shape, (Kind::Float, Device::Cpu)));
    let tensors = shapes.map(place).into();
    let mut state = AgentState { tensors, adam_steps: 0, multiplier: 0.0, carried_goal: CarriedGoal::GoalToObject };
    match decode_tensors(bytes) {
        Ok(weights) => said(import(&weights, &mut state)),
        problem => said(problem),
    }
}

/// Whether they are a state that can be trained on.
fn is_state(bytes: &[u8]) -> bool {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let manifest = Manifest {
        schema_version: proto::SCHEMA_VERSION,
        rollout: 1,
        frames: 8,
        exchange: 4,
        adam_steps: 1,
        tensors: "a.safetensors".into(),
        tensors_bytes: bytes.len() as u64,
        tensors_sha256: sha256(bytes),
        machine: Machine { threads: 1, learners: 1, ..Machine::default() },
        ..Manifest::default()
    };
    std::fs::write(folder.path().join("a.safetensors"), bytes).expect("the temporary folder has room");
    std::fs::write(folder.path().join("a.json"), manifest.seal()).expect("the temporary folder has room");
    let found = read(&folder.path().join("a.json"));
    match &found {
        Ok((snapshot, _)) => {
            let states = &snapshot.boundary.environments;
            assert!(states.iter().all(|state| state.actions().len() <= 100_000 && state.episode < u32::MAX));
        }
        Err(rejected) => assert!(!rejected.reason.is_empty()),
    }
    found.is_ok()
}
