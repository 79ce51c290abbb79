//! The real learner process against stand-in actors: it ends on its budget, and whatever kills, stops or starves it
//! on the way, the weights at the end are the same.

mod support;

use learner::agent::Agent;
use learner::checkpoint::encode_tensors;
use proto::config::{CarriedGoal, LagrangianConfig, Memory};
use proto::evaluation::{EvaluationConfig, ObjectSet};
use proto::event::LearnerEvent;
use proto::exit::{EXIT_NON_FINITE, EXIT_UNSAVED};
use proto::kitchen::Split;
use proto::metric;
use std::path::Path;
use std::process::Command;
use std::sync::OnceLock;
use support::{Ended, Plan, Rig, tiny, tiny_numbers, tiny_privileged};
use tch::Device;
use wire::WireAddress;

/// Weights of the run that nothing happened to.
fn undisturbed() -> &'static str {
    static WEIGHTS: OnceLock<String> = OnceLock::new();
    WEIGHTS.get_or_init(|| to_its_end(&mut Rig::new("plain", tiny())))
}

fn complete(rig: &Rig, ended: &Ended) -> String {
    let (frames, weights, complete) = ended.finished();
    assert!(complete && frames == rig.budget(), "{ended:?}");
    weights
}

/// Weights of a learner to which nothing happens any more.
fn to_its_end(rig: &mut Rig) -> String {
    let ended = rig.learner(&Plan::Undisturbed);
    assert!(ended.status.success(), "{ended:?}");
    complete(rig, &ended)
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
    let mut rig = Rig::new("repeat", tiny());
    let ended = rig.learner(&Plan::Undisturbed);
    assert_eq!(complete(&rig, &ended), undisturbed());
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
    let again = rig.learner(&Plan::Undisturbed);
    assert_eq!(complete(&rig, &again), undisturbed());
    assert!(trained(&again).is_empty());
}

/// What is not recorded is not trained on: the learner goes back to the boundary before, which is.
#[test]
fn a_rollout_whose_recording_is_not_written_is_given_up() {
    let mut config = tiny();
    config.recording.enabled = true;
    config.checkpoint.interval_s = 300.0;
    let cases = [("unwritten", Plan::CutLifelineUnwritten(2), 21), ("unrecorded", Plan::FailRecording(2), 22)];
    for (name, plan, incarnation) in cases {
        let mut rig = Rig::new(name, config.clone());
        let ended = rig.learner(&plan);
        assert!(ended.status.success(), "{ended:?}");
        assert_eq!(trained(&ended), vec![(0, 24, 0), (1, 48, 0)], "{}", ended.stderr);
        let (frames, _, whole) = ended.finished();
        assert_eq!((frames, whole), (48, false));
        assert!(rig.run_folder().checkpoint_manifest(2).exists() && !rig.run_folder().checkpoint_manifest(3).exists());
        rig.next_incarnation(incarnation);
        assert_eq!(to_its_end(&mut rig), undisturbed());
    }
}

/// An actor of which the recorder has nothing does not count as having answered.
#[test]
fn a_learner_does_not_answer_what_the_recorder_does_not_have() {
    let mut config = tiny();
    config.recording.enabled = true;
    config.learner.actor_deadline_s = 3.0;
    let mut rig = Rig::new("untaken", config);
    let ended = rig.learner(&Plan::LoseReceipts);
    assert!(!ended.status.success() && trained(&ended).is_empty(), "{ended:?}");
    assert!(ended.stderr.contains("actors 0, 1 did not answer within 6 s"), "{}", ended.stderr);
}

/// A folder where the file of a checkpoint is to be written stands for a full disk.
#[test]
fn a_checkpoint_that_cannot_be_written_costs_nothing_but_at_the_end() {
    let mut rig = Rig::new("unsaved", tiny());
    let obstacle =
        |rig: &Rig, rollout: u64| rig.run_folder().checkpoint_tensors(rollout).with_added_extension("partial");
    let amid = obstacle(&rig, 2);
    std::fs::create_dir_all(&amid).unwrap();
    let ended = rig.learner(&Plan::Undisturbed);
    assert_eq!(complete(&rig, &ended), undisturbed(), "the run goes on, and saves the next time");
    for part in ["cannot write checkpoint", "The run goes on and tries again", "last checkpoint (rollout 1) is lost"] {
        assert!(ended.stderr.contains(part), "{part}: {}", ended.stderr);
    }

    // Without its last one, or its first, it may not end well.
    for (name, rollout) in [("unsavedlast", 5), ("unsavedfirst", 0)] {
        let mut rig = Rig::new(name, tiny());
        let there = obstacle(&rig, rollout);
        std::fs::create_dir_all(&there).unwrap();
        let ended = rig.learner(&Plan::Undisturbed);
        assert_eq!(ended.status.code(), Some(EXIT_UNSAVED), "{ended:?}");
        std::fs::remove_dir(&there).unwrap();
        assert_eq!(to_its_end(&mut rig), undisturbed());
    }
}

/// `kills.rs` of the system's tests kills such a run.
#[test]
fn the_multiplier_of_a_constrained_run_moves_and_reaches_the_policy() {
    let mut config = tiny();
    for stage in &mut config.stages {
        stage.reward = "lagrangian".into();
    }
    let [moving, fixed] = [3e3, 0.0].map(|learning_rate| {
        // Stand-ins disturb by millimetres: a rate that makes their multiplier felt.
        config.reward.lagrangian = LagrangianConfig { initial: 1.0, learning_rate };
        to_its_end(&mut Rig::new(&format!("bound{}", u8::from(learning_rate > 0.0)), config.clone()))
    });
    assert_ne!(moving, fixed);
}

/// `learner import` into a run: whether it worked, and what it printed on both streams.
fn import(rig: &Rig, from: &Path) -> (bool, String, String) {
    let run = Command::new(env!("CARGO_BIN_EXE_learner"))
        .arg("import")
        .args([Path::new("--from"), from, Path::new("--run"), rig.run_folder().root()])
        .output()
        .expect("the learner starts");
    let text = |printed| String::from_utf8(printed).expect("text");
    (run.status.success(), text(run.stdout), text(run.stderr))
}

#[test]
fn a_run_goes_on_from_the_weights_it_was_given() {
    let mut donor = Rig::new("donor", tiny());
    let weights = to_its_end(&mut donor);
    let from = donor.run_folder().checkpoint_tensors(5);
    let mut rig = Rig::new("given", tiny());
    let (good, said, complaint) = import(&rig, &from);
    assert!(good && said.ends_with(&format!("weights: {weights}\n")), "{said}{complaint}");
    let ended = rig.learner(&Plan::Undisturbed);
    assert!(matches!(&ended.events[0], LearnerEvent::Ready { rollout: 0, frames: 0, checkpoint: Some(_), .. }));
    assert_eq!(trained(&ended).len(), 5, "the whole budget is before it");
    assert!(![undisturbed(), &weights].contains(&complete(&rig, &ended).as_str()));
    // A run that has begun keeps its own.
    let (good, _, complaint) = import(&rig, &from);
    assert!(!good && complaint.contains("has begun"), "{complaint}");

    // The sign of its goal vector is the policy's own, and the checkpoint tells it.
    assert!(
        said.contains("object_to_goal while the target is held (network.carried_goal; the checkpoint's)"),
        "{said}"
    );
    let mut other = tiny();
    other.network.carried_goal = CarriedGoal::GoalToObject;
    let rig = Rig::new("other", other);
    let (good, _, complaint) = import(&rig, &from);
    assert!(!good && complaint.contains("trained with network.carried_goal = \"object_to_goal\""), "{complaint}");

    // A file of torch.save is a zip archive.
    let pickled = rig.run_folder().root().join("exp.pt");
    std::fs::write(&pickled, b"PK\x03\x04and so on").expect("a file is written");
    let (good, _, complaint) = import(&rig, &pickled);
    assert!(!good && complaint.contains("python3 -c \"import torch, safetensors.torch as s;"), "{complaint}");
    assert!(complaint.contains("exp.safetensors')\""), "{complaint}");

    let mut wider = tiny();
    wider.network.hidden = 24;
    let rig = Rig::new("wider", wider);
    let (good, _, complaint) = import(&rig, &from);
    assert!(!good && complaint.contains("network.hidden = 24 instead of 16"), "{complaint}");
    // Without its manifest only the shapes tell.
    let alone = rig.run_folder().root().join("alone.safetensors");
    std::fs::copy(&from, &alone).expect("it is copied");
    let (good, _, complaint) = import(&rig, &alone);
    assert!(!good && complaint.contains("`model.actor.weight` (here `actor.weight`) is Float [21, 16]"), "{complaint}");
    assert!(!rig.run_folder().checkpoint_manifest(0).exists());
    let mut bytes = std::fs::read(&from).expect("it is there");
    *bytes.last_mut().expect("it has bytes") ^= 1;
    std::fs::write(&from, bytes).expect("it is written");
    let (good, _, complaint) = import(&rig, &from);
    assert!(!good && complaint.contains("is damaged: its SHA-256"), "{complaint}");
}

/// Wherever the learner of a task of numbers dies, or one of its actors, the weights at the end are the same.
#[test]
fn a_run_without_frames_ends_in_the_same_bits_whatever_happens_on_the_way() {
    for (memory, privileged, overlap) in
        [(Memory::None, false, true), (Memory::Gru, false, false), (Memory::Lstm, true, true)]
    {
        let mut config = if privileged { tiny_privileged(memory) } else { tiny_numbers(memory) };
        config.ppo.overlap = overlap;
        let name = |what: &str| format!("{}{}{what}", memory.states(), u8::from(overlap));
        let mut rig = Rig::new(&name("nu"), config.clone());
        let weights = to_its_end(&mut rig);

        let mut rig = Rig::new(&name("nk"), config.clone());
        for point in ["learner.mid_rollout:9", "learner.after_update:2", "learner.after_manifest:2"] {
            let killed = rig.learner(&Plan::Fault(point));
            assert!(!killed.status.success(), "{point} was not reached: {killed:?}");
        }
        assert_eq!(to_its_end(&mut rig), weights, "{memory:?}, {overlap}");

        let mut rig = Rig::new(&name("na"), config.clone());
        let ended = rig.learner(&Plan::CrashActorAfter(1, 1));
        assert_eq!(complete(&rig, &ended), weights, "{memory:?}, {overlap}: {}", ended.stderr);

        let mut rig = Rig::new(&name("ns"), config);
        let stopped = rig.learner(&Plan::StopAfter(1));
        assert!(stopped.status.success(), "{stopped:?}");
        rig.next_incarnation(2);
        assert_eq!(to_its_end(&mut rig), weights, "{memory:?}, {overlap}");
    }
}

/// A run of numbers begins with the weights of another, or with those of `CleanRL`.
#[test]
fn a_run_without_frames_goes_on_from_the_weights_it_was_given() {
    let config = tiny_numbers(Memory::None);
    let mut donor = Rig::new("numdonor", config.clone());
    let weights = to_its_end(&mut donor);
    let rig = Rig::new("numgiven", config.clone());
    let (good, said, complaint) = import(&rig, &donor.run_folder().checkpoint_tensors(5));
    assert!(good && said.ends_with(&format!("weights: {weights}\n")), "{said}{complaint}");

    let agent = Agent::new(&config, Device::Cpu).unwrap();
    let own = agent.state().tensors.into_iter();
    let theirs = own.filter_map(|(name, weight)| Some((name.strip_prefix("model.")?.to_owned(), weight))).collect();
    let rig = Rig::new("numclean", config);
    let file = rig.run_folder().root().join("agent.safetensors");
    std::fs::write(&file, encode_tensors(&theirs).unwrap()).unwrap();
    let (good, said, complaint) = import(&rig, &file);
    assert!(good && said.ends_with(&format!("weights: {}\n", agent.weights_digest())), "{said}{complaint}");
}

/// With the other sign a policy would see its goal in the opposite direction.
#[test]
fn a_run_goes_on_with_the_sign_it_was_trained_with() {
    let mut rig = Rig::new("sign", tiny());
    let stopped = rig.learner(&Plan::StopAfter(1));
    assert!(stopped.status.success(), "{stopped:?}");
    let file = rig.run_folder().config();
    let whole = std::fs::read_to_string(&file).expect("it was written");
    std::fs::write(&file, whole.replace("\"object_to_goal\"", "\"goal_to_object\"")).expect("it is written");
    let refused = Command::new(env!("CARGO_BIN_EXE_learner"))
        .arg("--run")
        .arg(rig.run_folder().root())
        .args(["--wire", &WireAddress::new("sign", 2).to_string()])
        .output()
        .expect("the learner starts");
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(!refused.status.success() && said.contains("Set network.carried_goal = \"object_to_goal\""), "{said}");

    // A run from before the key was there goes on as it was.
    let older: Vec<&str> = whole.lines().filter(|line| !line.starts_with("carried_goal")).collect();
    assert_eq!(older.len() + 1, whole.lines().count());
    std::fs::write(&file, older.join("\n")).expect("it is written");
    rig.next_incarnation(2);
    assert_eq!(to_its_end(&mut rig), undisturbed());
}

#[test]
fn the_frames_of_the_learning_rate_reach_the_training() {
    let mut config = tiny();
    config.ppo.learning_rate_frames = 96;
    let start = config.ppo.learning_rate;
    let mut rig = Rig::new("rate", config);
    let ended = rig.learner(&Plan::Undisturbed);
    let rate = |event: &LearnerEvent| match event {
        LearnerEvent::RolloutTrained { metrics, .. } => Some(metrics[metric::LEARNING_RATE] / start),
        _ => None,
    };
    let rates: Vec<f64> = ended.events.iter().filter_map(rate).collect();
    // A quarter of 96 frames a rollout, and in the second stage from the start again.
    let expected = [0.0, 0.25, 0.5, 0.0, 0.25].map(|share| 1.0 - 2.0 / 3.0 * share);
    assert!(rates.len() == 5 && rates.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{rates:?}");
}

#[test]
fn an_actor_that_never_comes_back_is_named_and_the_work_saved() {
    let mut config = tiny();
    config.learner.actor_deadline_s = 3.0;
    let mut rig = Rig::new("lost", config);
    let lost = rig.learner(&Plan::LoseActorAfter(1, 1));
    assert_eq!(lost.status.code(), Some(1), "{lost:?}");
    assert!(
        lost.stderr.contains("actor 1 did not answer within 6 s, twice learner.actor_deadline_s"),
        "{}",
        lost.stderr
    );
    let told = lost.events.iter().any(|event| matches!(event, LearnerEvent::WaitingForActor { actor: 1, .. }));
    assert!(told, "{lost:?}");
    let saved = lost.events.iter().rev().find_map(|event| match event {
        LearnerEvent::CheckpointWritten { frames, .. } => Some(*frames),
        _ => None,
    });
    assert!(saved >= Some(48), "{lost:?}");
}

#[test]
fn actors_are_connected_before_the_first_rollout_is_collected() {
    let mut config = tiny();
    // Two halves of one environment each: they take turns, so they need never be complete at the same moment.
    config.actors.environments_per_actor = 2;
    config.stages.truncate(1);
    let mut rig = Rig::new("connected", config);
    let ended = rig.learner(&Plan::Undisturbed);
    complete(&rig, &ended);
    let at = |wanted: fn(&LearnerEvent) -> bool| ended.events.iter().position(wanted);
    let connected = at(|event| matches!(event, LearnerEvent::ActorsConnected { .. }));
    let collected = at(|event| matches!(event, LearnerEvent::RolloutCollected { .. }));
    assert!(connected.is_some() && connected < collected, "{ended:?}");
}

#[test]
fn a_number_that_is_not_finite_has_a_status_of_its_own_and_leaves_a_dump() {
    let mut config = tiny();
    // Finite rewards, but their squares are not.
    config.reward.weights.insert("lambda_disturb".to_owned(), 1e30);
    let mut rig = Rig::new("poison", config);
    let failed = rig.learner(&Plan::Undisturbed);
    assert_eq!(failed.status.code(), Some(EXIT_NON_FINITE), "{failed:?}");
    // The first rollout of the second stage, the one whose reward counts disturbance.
    let dump = rig.run_folder().nonfinite_dump(3, 0);
    assert!(failed.stderr.contains(&dump.display().to_string()), "{}", failed.stderr);
    let bytes = std::fs::read(&dump).unwrap();
    let dump = safetensors::SafeTensors::deserialize(&bytes).unwrap();
    let frames = dump.tensor("rollout.frames").unwrap();
    assert_eq!(frames.shape()[..2], [4, 6]);
    assert!(frames.data().iter().any(|&byte| byte != 0));
    let rewards = dump.tensor("rollout.reward").unwrap();
    let rewards = rewards.data().chunks_exact(4).map(|word| f32::from_le_bytes(word.try_into().unwrap()));
    assert!(rewards.map(f32::abs).fold(0.0, f32::max) > 1e25);
    assert!(dump.tensor("beliefs").is_ok(), "what the rollout began with is there too");
}

/// Both passed for any other failure.
#[test]
fn an_observation_that_is_not_finite_has_that_status_too() {
    let mut rig = Rig::new("blind", tiny());
    let failed = rig.learner(&Plan::PoisonActorAfter(0, 1));
    assert_eq!(failed.status.code(), Some(EXIT_NON_FINITE), "{failed:?}");
    assert!(failed.stderr.contains("actor 1, kitchen 3, environment"), "{}", failed.stderr);
    assert!(failed.stderr.contains("its goal_m[1] is not finite"), "{}", failed.stderr);
    let dump = (0..5).map(|rollout| rig.run_folder().nonfinite_dump(rollout, 0)).find(|dump| dump.exists());
    let dump = dump.unwrap_or_else(|| panic!("there is no dump: {}", failed.stderr));
    assert!(failed.stderr.contains(&dump.display().to_string()), "{}", failed.stderr);
}

#[test]
fn a_number_that_is_not_finite_has_that_status_in_an_evaluation_too() {
    // Finite weights that no finite number comes out of.
    let mut weights = Agent::new(&tiny(), Device::Cpu).unwrap().state().tensors;
    for weight in weights.values_mut() {
        let _ = weight.fill_(1e30);
    }
    let donor = Rig::new("huge", tiny());
    let file = donor.folder.path().join("huge.safetensors");
    std::fs::write(&file, encode_tensors(&weights).unwrap()).unwrap();
    let (good, _, complaint) = import(&donor, &file);
    assert!(good, "{complaint}");

    let mut config = tiny();
    config.actors.count = 5;
    config.evaluation = Some(EvaluationConfig {
        deterministic: true,
        checkpoint: Some(donor.run_folder().checkpoint_manifest(0).display().to_string()),
        ..EvaluationConfig::fixed(Split::Validation, ObjectSet::Novel, 1)
    });
    let mut rig = Rig::new("examined", config);
    let failed = rig.learner(&Plan::Undisturbed);
    assert_eq!(failed.status.code(), Some(EXIT_NON_FINITE), "{failed:?}");
    assert!(failed.stderr.contains("policy or value is not finite"), "{}", failed.stderr);
    let Some(LearnerEvent::Ready { device, .. }) = failed.events.first() else { panic!("{failed:?}") };
    assert_eq!(device, "cpu, 1 thread");
}
