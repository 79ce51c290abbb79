//! What the store promises: a state comes back bit for bit, what is broken is named and passed over, and a failure to
//! write leaves everything before it untouched.

use super::*;
use crate::collector::RunningEpisode;
use proptest::prelude::*;
use proto::checkpoint::{Machine, Manifest};
use proto::config::{CarriedGoal, StageConfig};
use proto::episode::MAX_EPISODE_STEPS;
use proto::event::Timing;
use proto::run_folder::RunFolder;
use proto::trained::{History, Trained};
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use std::collections::BTreeMap;
use std::path::PathBuf;
use tch::{Kind, Tensor};
use wire::message::EnvironmentState;

const RUN: &str = "0123456789ab";

fn machine() -> Machine {
    let (torch, device, arithmetic) = ("2.11.0".into(), "cpu".into(), "avx2".into());
    Machine { torch, device, threads: 2, arithmetic, learners: 1, shards: 0 }
}

/// A run folder, and its store.
fn fresh(keep: u32) -> (tempfile::TempDir, Store) {
    let folder = tempfile::tempdir().unwrap();
    name(&folder, RUN);
    let store = store_of(&folder, RUN, keep);
    (folder, store)
}

fn store_of(folder: &tempfile::TempDir, id: &str, keep: u32) -> Store {
    let stages = ["I", "II"].map(|name| StageConfig { name: name.into(), reward: "r".into(), frames: 100 }).to_vec();
    Store::new((RunFolder::new(folder.path()), id), &stages, "seed = 1", machine(), keep)
}

fn name(folder: &tempfile::TempDir, id: &str) {
    std::fs::write(RunFolder::new(folder.path()).identity(), format!("id = {id:?}\n")).unwrap();
}

/// Figures of rollouts before this one.
fn figures(rollout: u64) -> History {
    let mut figures = History::default();
    for rollout in 0..rollout {
        let metrics = BTreeMap::from([("loss/value".to_owned(), 1.0 / (3.0 + rollout as f64))]);
        let (frames, timing) = ((rollout + 1) * 20, Timing { update_s: 0.1, ..Timing::default() });
        figures.insert(Trained {
            rollout,
            frames,
            at_unix_s: 5,
            timing,
            metrics: metrics.into(),
            ..Trained::default()
        });
    }
    figures
}

fn snapshot(rollout: u64) -> Snapshot {
    let mut state = EnvironmentState::start_of(rollout as u32);
    (0..5).for_each(|action| state.push(&[action]));
    let weights = Tensor::from_slice(&[1.5_f32, -0.0, f32::MIN_POSITIVE, rollout as f32]).reshape([2, 2]);
    let tensors = BTreeMap::from([
        ("adam.first".to_owned(), Tensor::from_slice(&[0.25_f64, 1e-300])),
        ("beliefs".to_owned(), Tensor::zeros([3, 0], (Kind::Float, tch::Device::Cpu))),
        // A transposed view: what is stored is its values in order, not its memory.
        ("model.weight".to_owned(), weights.tr()),
    ]);
    Snapshot {
        rollout,
        frames: rollout * 20,
        // A multiplier of many digits: 0.1 + 0.2 and then some.
        agent: AgentState {
            tensors,
            adam_steps: 7,
            multiplier: 0.1 + 0.2 + 1e-9 * rollout as f64,
            carried_goal: if rollout.is_multiple_of(2) { CarriedGoal::ObjectToGoal } else { CarriedGoal::GoalToObject },
        },
        boundary: Boundary {
            exchange: rollout * 4,
            environments: vec![state, EnvironmentState::start_of(2)],
            running: vec![
                RunningEpisode {
                    episode_return: -0.1,
                    discounted_cost: 1.0 / 3.0,
                    discounted_return: 1e-7,
                    metrics: vec![1.0, 0.25],
                },
                RunningEpisode {
                    episode_return: 3e-310,
                    discounted_cost: -0.0,
                    discounted_return: -2.5,
                    metrics: vec![0.0, -0.5],
                },
            ],
        },
        weights: "ab".into(),
    }
}

fn same(a: &Snapshot, b: &Snapshot) -> bool {
    let tensors = |snapshot: &Snapshot| encode_tensors(&snapshot.agent.tensors).unwrap();
    (a.rollout, a.frames, a.agent.adam_steps, &a.weights) == (b.rollout, b.frames, b.agent.adam_steps, &b.weights)
        && a.agent.carried_goal == b.agent.carried_goal
        && a.agent.multiplier.to_bits() == b.agent.multiplier.to_bits()
        && a.boundary == b.boundary
        && tensors(a) == tensors(b)
}

fn save(store: &Store, rollout: u64) -> Result<String, CheckpointError> {
    store.save(&snapshot(rollout), &figures(rollout), false)
}

fn names(folder: &tempfile::TempDir) -> Vec<String> {
    let entries = std::fs::read_dir(folder.path().join("checkpoints")).unwrap();
    let mut names: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().to_string_lossy().replace("rollout-000000", "")).collect();
    names.sort();
    names
}

#[test]
fn a_state_comes_back_bit_for_bit() {
    let (_folder, store) = fresh(2);
    assert!(store.load().unwrap().is_none(), "a fresh run has none");
    let saved = snapshot(3);
    assert_eq!(store.save(&saved, &figures(saved.rollout), false).unwrap(), "checkpoints/rollout-00000003.json");
    let loaded = store.load().unwrap().unwrap();
    assert!(same(&loaded.snapshot, &saved));
    assert_eq!(loaded.figures, Ok(figures(3)));
    assert!(loaded.rejected.is_empty());
    assert_eq!(loaded.path, "checkpoints/rollout-00000003.json");
    assert_eq!(loaded.snapshot.agent.tensors["model.weight"].size(), [2, 2]);
    let Manifest { stage, stage_end, machine: stored, config, .. } = loaded.manifest;
    assert_eq!((stage, stage_end, &stored, config.as_str()), (0, false, &machine(), "seed = 1"));
    let other = Machine { threads: 4, ..machine() };
    assert_eq!(other.differences(&stored), ["threads 4 instead of 2"]);
    assert!(stored.differences(&machine()).is_empty());
}

#[test]
fn figures_of_no_rollout_and_of_many_come_back() {
    let (_folder, store) = fresh(2);
    for (rollout, count) in [(1, 0), (2, 1_000)] {
        let many = figures(count);
        assert_eq!(many.pieces().count() > 1, count > 0);
        store.save(&snapshot(rollout), &many, false).unwrap();
        assert_eq!(store.load().unwrap().unwrap().figures, Ok(many));
    }
}

#[test]
fn the_newest_and_every_stages_end_are_kept() {
    let (folder, store) = fresh(2);
    // 20 frames a rollout: stage I ends with rollout 5, stage II with rollout 10.
    for rollout in 0..=10 {
        save(&store, rollout).unwrap();
    }
    let of = |rollout: &str| ["json", "jsonl", "safetensors"].map(|kind| format!("{rollout}.{kind}"));
    assert_eq!(names(&folder), ["05", "09", "10"].map(of).concat());
    // What a crash leaves is swept with the next one.
    for left in ["rollout-00000011.safetensors", "rollout-00000011.jsonl", "rollout-00000012.safetensors.partial"] {
        std::fs::write(folder.path().join("checkpoints").join(left), "half").unwrap();
    }
    assert_eq!(store.load().unwrap().unwrap().snapshot.rollout, 10, "a checkpoint without a manifest does not exist");
    save(&store, 10).unwrap();
    assert_eq!(names(&folder).len(), 9);
}

#[test]
fn a_torn_one_does_not_push_a_good_one_out() {
    let (folder, store) = fresh(2);
    (1..=3).for_each(|rollout| drop(save(&store, rollout).unwrap()));
    std::fs::write(folder.path().join("checkpoints/rollout-00000003.safetensors"), "short").unwrap();
    let loaded = store.load().unwrap().unwrap();
    assert_eq!(loaded.snapshot.rollout, 2);
    assert_eq!(loaded.rejected.len(), 1);
    assert!(loaded.rejected[0].to_string().contains("rollout-00000003.safetensors is torn: it has 5 bytes of"));
    // The run goes on from 2 and passes 3 without saving there.
    save(&store, 4).unwrap();
    assert_eq!(names(&folder), ["02.json", "02.jsonl", "02.safetensors", "04.json", "04.jsonl", "04.safetensors"]);
}

#[test]
fn a_checkpoint_that_cannot_be_written_is_named_and_harms_nothing() {
    let (folder, store) = fresh(1);
    save(&store, 1).unwrap();
    let checkpoints = folder.path().join("checkpoints");
    for name in ["safetensors", "jsonl", "json"].map(|kind| format!("rollout-00000002.{kind}.partial")) {
        // A folder where the file is about to be written stands for a disk that does not take it.
        let obstacle = checkpoints.join(&name);
        std::fs::create_dir(&obstacle).unwrap();
        let error = save(&store, 2).unwrap_err().to_string();
        let path = checkpoints.join(name.trim_end_matches(".partial"));
        assert!(error.contains(&format!("cannot write checkpoint {}", path.display())), "{error}");
        assert!(error.contains("bytes are free there"), "{error}");
        let loaded = store.load().unwrap().unwrap();
        assert!(same(&loaded.snapshot, &snapshot(1)), "the last good one is untouched");
        std::fs::remove_dir(&obstacle).unwrap();
    }
    save(&store, 2).unwrap();
    assert_eq!(names(&folder), ["02.json", "02.jsonl", "02.safetensors"]);

    let cause = std::io::Error::from_raw_os_error(libc::ENOSPC);
    let full = CheckpointError::Write { path: checkpoints, cause, free_bytes: Some(0) }.to_string();
    assert!(full.contains("No space left on device") && full.contains("(0 bytes are free there"), "{full}");
}

#[test]
fn another_version_is_told_apart_from_a_broken_file() {
    let (folder, store) = fresh(1);
    save(&store, 1).unwrap();
    let path = folder.path().join("checkpoints/rollout-00000001.json");
    let text = std::fs::read_to_string(&path).unwrap();
    let ours = proto::SCHEMA_VERSION;
    let foreign = text.replace(&format!("\"schema_version\": {ours}"), "\"schema_version\": 99");
    assert_ne!(text, foreign);
    std::fs::write(&path, foreign).unwrap();
    let error = store.load().unwrap_err().to_string();
    assert!(error.contains(&format!("has schema version 99; this program reads {ours}")), "{error}");
}

/// A checkpoint can be whole, with all its digests right, and still not be one of ours.
#[test]
fn numbers_that_no_run_reaches_are_refused() {
    let changes: [(fn(&mut Snapshot), _); 4] = [
        (|saved| saved.boundary.environments[0].episode = u32::MAX, "no run gets so far"),
        (|saved| saved.boundary.environments[0].push(&[254]), "has an action 254"),
        (|saved| saved.boundary.running[0].episode_return = f64::NAN, "not finite"),
        (|saved| saved.boundary.exchange = u64::MAX, "counts to 18446744073709551615"),
    ];
    for (change, expected) in changes {
        let (_folder, store) = fresh(2);
        let mut saved = snapshot(1);
        change(&mut saved);
        store.save(&saved, &figures(saved.rollout), false).unwrap();
        let text = store.load().unwrap_err().to_string();
        assert!(text.contains(expected), "{text}");
    }
    // A manifest that leads elsewhere, as a checkpoint that somebody gives away may have one.
    let (folder, store) = fresh(2);
    save(&store, 1).unwrap();
    let path = folder.path().join("checkpoints/rollout-00000001.json");
    let manifest = Manifest::read(&path).unwrap();
    std::fs::write(&path, Manifest { tensors: "../elsewhere".into(), ..manifest }.seal()).unwrap();
    assert!(read(&path).unwrap_err().to_string().contains("not beside it: ../elsewhere"));
}

#[test]
fn episodes_of_any_length_come_back_and_those_of_older_versions_do() {
    let agent = snapshot(1).agent;
    let long: Vec<u8> = (0..MAX_EPISODE_STEPS).map(|step| (step % 21) as u8).collect();
    for width in [1, 8] {
        let (long, short) = (long.repeat(width), [250, 255, 9].repeat(width));
        // Of several bytes each may be anything.
        let short = if width == 1 { vec![7, 8, 9] } else { short };
        let environments = [(4, &long), (5, &short)].map(|(at, actions)| EnvironmentState::after(at, actions, width));
        let boundary = Boundary { environments: environments.into(), ..snapshot(1).boundary };
        let bytes = tensors::encode(&agent.tensors, &boundary).unwrap();
        assert!(bytes.len() < width * MAX_EPISODE_STEPS + 4096);
        assert_eq!(tensors::decode(&bytes, 4).unwrap().1, boundary);

        let mut with_snapshot = boundary;
        for bytes in [vec![3; 1000], vec![]] {
            with_snapshot.environments[1].remember(wire::message::Snapshot { state_hash: u64::MAX, bytes });
            let bytes = tensors::encode(&agent.tensors, &with_snapshot).unwrap();
            assert_eq!(tensors::decode(&bytes, 4).unwrap().1, with_snapshot);
        }
    }

    // Each column had room for 512 actions.
    let boundary = snapshot(1).boundary;
    let bytes = tensors::encode(&agent.tensors, &boundary).unwrap();
    let of_before = |rows: usize, counted: u32| {
        let file = SafeTensors::deserialize(&bytes).unwrap();
        let mut actions = vec![0; rows * 512];
        actions[..5].copy_from_slice(&[0, 1, 2, 3, 4]);
        let counts: Vec<u8> = [counted, 0].iter().flat_map(|count| count.to_le_bytes()).collect();
        let views = file.iter().map(|(name, view)| {
            let view = match name {
                "environment.actions" => TensorView::new(Dtype::U8, vec![rows, 512], &actions).unwrap(),
                "environment.action_count" => TensorView::new(Dtype::U32, vec![2], &counts).unwrap(),
                _ => view,
            };
            (name.to_owned(), view)
        });
        let bytes = safetensors::serialize(views.collect::<Vec<_>>(), None).unwrap();
        tensors::decode(&bytes, 4).map(|(_, boundary)| boundary).map_err(|error| error.to_string())
    };
    assert_eq!(of_before(2, 5), Ok(boundary));
    for (rows, counted) in [(1, 5), (3, 5), (2, 513), (2, u32::MAX)] {
        assert!(of_before(rows, counted).unwrap_err().contains("action"), "{rows} {counted}");
    }
}

/// The folder was removed while a learner worked, and made anew for another run.
#[test]
fn nothing_is_written_to_the_folder_of_another_run_and_its_checkpoints_are_passed_over() {
    let (folder, store) = fresh(2);
    save(&store, 1).unwrap();
    name(&folder, "another");
    let late = save(&store, 2).unwrap_err();
    assert!(matches!(late, CheckpointError::Foreign { .. }));
    let text = format!("is not the folder of run {RUN} any more (it is that of run another): nothing is written there");
    assert!(late.to_string().contains(&text), "{late}");
    std::fs::remove_file(folder.path().join("run.toml")).unwrap();
    let late = save(&store, 2).unwrap_err().to_string();
    assert!(late.contains("run.toml is gone or damaged"), "{late}");
    assert_eq!(names(&folder), ["01.json", "01.jsonl", "01.safetensors"]);

    name(&folder, "another");
    let other = store_of(&folder, "another", 2);
    assert!(other.load().unwrap().is_none(), "the run begins");
    save(&other, 0).unwrap();
    assert_eq!(other.load().unwrap().unwrap().snapshot.rollout, 0);
    // Whoever asks for that very checkpoint gets it.
    let manifest = RunFolder::new(folder.path()).checkpoint_manifest(1);
    assert_eq!(read(&manifest).unwrap().1.run, RUN);
    // The run gets there itself: the other's does not count as kept.
    for rollout in 1..=3 {
        save(&other, rollout).unwrap();
    }
    assert_eq!(other.load().unwrap().unwrap().manifest.run, "another");
    assert_eq!(names(&folder).len(), 6);
}

#[test]
fn damaged_figures_cost_no_weights() {
    let (folder, store) = fresh(2);
    (1..=2).for_each(|rollout| drop(save(&store, rollout).unwrap()));
    let loaded = store.load().unwrap().unwrap();
    assert!(same(&loaded.snapshot, &snapshot(2)) && loaded.figures == Ok(figures(2)));
    std::fs::write(folder.path().join("checkpoints/rollout-00000002.jsonl"), "{}").unwrap();
    let loaded = store.load().unwrap().unwrap();
    assert_eq!(loaded.snapshot.rollout, 2);
    let reason = loaded.figures.unwrap_err();
    assert!(reason.contains("rollout-00000002.jsonl does not match the checksum"), "{reason}");
    // The run goes on with what its other file has.
    std::fs::write(folder.path().join("metrics.jsonl"), figures(5).encode()).unwrap();
    assert_eq!(store.figures_of_file(2), figures(2));
}

#[test]
fn a_checkpoint_of_an_older_version_is_taken() {
    let (folder, store) = fresh(2);
    save(&store, 1).unwrap();
    let path = RunFolder::new(folder.path()).checkpoint_manifest(1);
    let manifest = Manifest::read(&path).unwrap();
    std::fs::write(&path, Manifest { run: String::new(), figures_sha256: String::new(), ..manifest }.seal()).unwrap();
    let text = std::fs::read_to_string(&path).unwrap();
    assert!(!text.contains("\"run\"") && !text.contains("figures"), "as it wrote it: {text}");
    let loaded = store.load().unwrap().unwrap();
    assert!(loaded.figures.is_err_and(|reason| reason.contains("older version")));
}

#[test]
fn one_that_is_to_be_evaluated_is_pinned_before_it_can_be_pruned() {
    let (folder, store) = fresh(1);
    store.save(&snapshot(1), &figures(1), true).unwrap();
    save(&store, 2).unwrap();
    let place = RunFolder::new(folder.path()).validation(1);
    assert!(!folder.path().join("checkpoints/rollout-00000001.json").exists());
    assert_eq!(read(&place.join("rollout-00000001.json")).unwrap().0.rollout, 1);
    assert!(!RunFolder::new(folder.path()).validation(2).exists());
    // Damaged, and a learner that went back writes it again.
    std::fs::write(place.join("rollout-00000001.safetensors"), "").unwrap();
    store.save(&snapshot(1), &figures(1), true).unwrap();
    assert_eq!(read(&place.join("rollout-00000001.json")).unwrap().0.rollout, 1);
}

fn files(folder: &tempfile::TempDir) -> [PathBuf; 2] {
    ["json", "safetensors"].map(|kind| folder.path().join(format!("checkpoints/rollout-00000002.{kind}")))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    /// Bytes that pass every digest, because whoever changed them made the digest anew: they are a state or an error.
    #[test]
    fn any_bytes_are_a_state_or_an_error(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
        in_header: bool,
        cut in prop::option::weighted(0.2, any::<prop::sample::Index>()),
    ) {
        let saved = snapshot(1);
        let mut bytes = tensors::encode(&saved.agent.tensors, &saved.boundary).unwrap();
        let header = 8 + u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
        let length = if in_header { header } else { bytes.len() };
        for (place, byte) in changes {
            bytes[place.index(length)] = byte;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(length));
        }
        if let Ok((_, boundary)) = tensors::decode(&bytes, 7) {
            prop_assert!(boundary.environments.iter().all(|state| state.actions().len() <= MAX_EPISODE_STEPS));
            prop_assert!(boundary.environments.iter().all(|state| state.episode < u32::MAX));
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    /// Whatever single bit flips, in whichever file, and wherever a file is cut: the damage is seen, the file named,
    /// and the checkpoint before it taken.
    #[test]
    fn no_damage_goes_unnoticed(which in 0usize..2, place in any::<prop::sample::Index>(), bit in 0u8..8, cut: bool) {
        let (folder, store) = fresh(2);
        save(&store, 1).unwrap();
        save(&store, 2).unwrap();
        let path = &files(&folder)[which];
        let mut content = std::fs::read(path).unwrap();
        let place = place.index(content.len());
        // White space between JSON's tokens carries nothing.
        prop_assume!(cut || which == 1 || !content[place].is_ascii_whitespace());
        if cut {
            content.truncate(place);
        } else {
            content[place] ^= 1 << bit;
        }
        std::fs::write(path, &content).unwrap();
        let loaded = store.load().unwrap().unwrap();
        prop_assert!(same(&loaded.snapshot, &snapshot(1)));
        prop_assert_eq!(loaded.rejected.len(), 1);
        prop_assert_eq!(&loaded.rejected[0].path, path);
    }
}
