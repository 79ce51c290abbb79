//! The real learner process against stand-in actors: it ends on its budget, and whatever kills, stops or starves it
//! on the way, the weights at the end are the same.

mod support;

use proto::control::LearnerEvent;
use std::sync::OnceLock;
use support::{Ended, Plan, Scene, tiny};

/// Weights of the run that nothing happened to.
fn undisturbed() -> &'static str {
    static WEIGHTS: OnceLock<String> = OnceLock::new();
    WEIGHTS.get_or_init(|| {
        let mut scene = Scene::new("plain", tiny());
        let ended = scene.learner(&Plan::Undisturbed);
        assert!(ended.status.success(), "{ended:?}");
        complete(&scene, &ended)
    })
}

fn complete(scene: &Scene, ended: &Ended) -> String {
    let (frames, weights, complete) = ended.finished();
    assert!(complete && frames == scene.budget(), "{ended:?}");
    weights
}

fn trained(ended: &Ended) -> Vec<(u64, u64, u32)> {
    let trained = |event: &LearnerEvent| match *event {
        LearnerEvent::RolloutTrained { rollout, frames, stage, .. } => Some((rollout, frames, stage)),
        _ => None,
    };
    ended.events.iter().filter_map(trained).collect()
}

#[test]
fn a_run_ends_on_its_budget_and_repeats_bit_for_bit() {
    let mut scene = Scene::new("repeat", tiny());
    let ended = scene.learner(&Plan::Undisturbed);
    assert_eq!(complete(&scene, &ended), undisturbed());
    // 6 environments, 4 steps: 24 frames a rollout, the last of a stage cut to its budget of 62 and 40.
    assert_eq!(
        trained(&ended),
        vec![(0, 24, 0), (1, 48, 0), (2, 62, 0), (3, 86, 1), (4, 102, 1)],
        "every rollout once, every stage to its last frame"
    );
    assert!(matches!(ended.events[0], LearnerEvent::CheckpointWritten { rollout: 0, .. } | LearnerEvent::Ready { .. }));
    let connected = ended.events.iter().filter(|event| matches!(event, LearnerEvent::ActorsConnected { .. }));
    assert_eq!(connected.count(), 1);
    // One more start finds nothing to do and says so.
    let again = scene.learner(&Plan::Undisturbed);
    assert_eq!(complete(&scene, &again), undisturbed());
    assert!(trained(&again).is_empty());
}

#[test]
fn a_learner_killed_anywhere_goes_on_to_the_same_weights() {
    for (i, point) in [
        "learner.before_checkpoint",
        "learner.after_tensors",
        "learner.after_tensors:3",
        "learner.after_manifest:2",
        "learner.mid_rollout:1",
        "learner.mid_rollout:7",
        "learner.before_update:3",
        "learner.after_update:2",
    ]
    .iter()
    .enumerate()
    {
        let mut scene = Scene::new(&format!("fault{i}"), tiny());
        let killed = scene.learner(&Plan::Fault(point));
        assert!(!killed.status.success(), "{point} was not reached: {killed:?}");
        let ended = scene.learner(&Plan::Undisturbed);
        assert_eq!(complete(&scene, &ended), undisturbed(), "{point}: {}", ended.stderr);
    }
}

#[test]
fn a_stopped_run_resumes_to_the_same_weights() {
    let mut scene = Scene::new("stop", tiny());
    let stopped = scene.learner(&Plan::StopAfter(1));
    assert!(stopped.status.success());
    let (frames, _, complete_) = stopped.finished();
    assert_eq!((frames, complete_), (48, false), "{stopped:?}");
    scene.next_incarnation(2);
    let ended = scene.learner(&Plan::Undisturbed);
    assert_eq!(complete(&scene, &ended), undisturbed());
    assert_eq!(trained(&ended)[0].0, 2, "nothing is trained twice");
}

#[test]
fn an_orchestrator_that_vanishes_is_noticed_and_the_work_saved() {
    let mut scene = Scene::new("lifeline", tiny());
    let orphan = scene.learner(&Plan::CutLifelineAfter(0));
    assert!(orphan.status.success(), "{orphan:?}");
    let (frames, _, done) = orphan.finished();
    assert!(!done && frames >= 24, "{orphan:?}");
    scene.next_incarnation(3);
    let ended = scene.learner(&Plan::Undisturbed);
    assert_eq!(complete(&scene, &ended), undisturbed());
}

#[test]
fn an_actor_that_dies_is_waited_for_and_restored() {
    for (i, rollout) in [0, 1, 2].into_iter().enumerate() {
        let mut scene = Scene::new(&format!("actor{i}"), tiny());
        let ended = scene.learner(&Plan::CrashActorAfter(rollout, 1));
        assert_eq!(complete(&scene, &ended), undisturbed());
    }
}

#[test]
fn an_actor_that_never_comes_back_is_named_and_the_work_saved() {
    let mut config = tiny();
    config.learner.actor_deadline_s = 3.0;
    let mut scene = Scene::new("lost", config);
    let lost = scene.learner(&Plan::LoseActorAfter(1, 1));
    assert_eq!(lost.status.code(), Some(1), "{lost:?}");
    assert!(lost.stderr.contains("actor 1 did not answer within 3 s"), "{}", lost.stderr);
    let told = lost.events.iter().any(|event| matches!(event, LearnerEvent::WaitingForActor { actor: 1, .. }));
    assert!(told, "{lost:?}");
    let saved = lost.events.iter().rev().find_map(|event| match event {
        LearnerEvent::CheckpointWritten { frames, .. } => Some(*frames),
        _ => None,
    });
    assert!(saved >= Some(48), "{lost:?}");
}

#[test]
fn a_torn_checkpoint_is_named_and_skipped_and_only_torn_ones_are_refused() {
    let mut scene = Scene::new("torn", tiny());
    let stopped = scene.learner(&Plan::StopAfter(2));
    assert!(stopped.status.success(), "{stopped:?}");
    let run = scene.run_folder();
    let newest = run.checkpoint_tensors(3);
    let content = std::fs::read(&newest).unwrap();
    std::fs::write(&newest, &content[..content.len() / 2]).unwrap();
    scene.next_incarnation(4);
    let stopped = scene.learner(&Plan::StopAfter(2));
    assert!(stopped.stderr.contains("rollout-00000003.safetensors is torn"), "{}", stopped.stderr);
    assert_eq!(trained(&stopped)[0].0, 2, "it goes on from the one before");

    for entry in std::fs::read_dir(run.checkpoints()).unwrap() {
        let path = entry.unwrap().path();
        let mut content = std::fs::read(&path).unwrap();
        let middle = content.len() / 2;
        content[middle] ^= 0x10;
        std::fs::write(&path, content).unwrap();
    }
    let refused = scene.learner(&Plan::Undisturbed);
    assert_eq!(refused.status.code(), Some(1), "{refused:?}");
    assert!(refused.events.is_empty(), "{refused:?}");
    assert!(refused.stderr.contains("no checkpoint in") && refused.stderr.contains("rollout-00000003"));
}

#[test]
fn check_tells_what_it_computes_with() {
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_learner")).arg("check").output().unwrap();
    assert!(output.status.success(), "{output:?}");
    let line: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(line["torch"], "2.11.0");
    assert!(line["devices"].as_array().unwrap().contains(&"cpu".into()), "{line}");
}
