//! The recorder against real shared memory, read back by the code that replays.

mod failures;
mod live;
mod made_up;
mod receipts;
mod throughput;

use super::testing::{self, EPISODE_STEPS, FakeActor, Record, action, hash};
use super::{Recorder, RecorderSetup};
use crate::recording::episodes::gather;
use crate::recording::form::{Carries, Told};
use crate::recording::reader::{FileEnd, RecordingError, read, read_with_trust};
use crate::recording::repair::{Repair, repair};
use crate::recording::schema::stillroom::LearnerMetrics;
use crate::recording::tests::{ARM, said, those};
use crate::recording::wanted::Wanted;
use mcap::records::Record as McapRecord;
use proptest::prelude::*;
use prost::Message;
use proto::config::Config;
use proto::evaluation::{EvaluationConfig, ObjectSet};
use proto::event::{LearnerEvent, Timing};
use proto::kitchen::Split;
use proto::metric;
use proto::record::flag;
use proto::run_folder::RunFolder;
use proto::shares::Shares;
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::time::Duration;
use wire::{WireAddress, WireHost, WireShape};

/// Two actors of a learner each.
fn shape() -> WireShape {
    testing::shape(Shares::new(2, 2), 3)
}

struct Bench {
    address: WireAddress,
    _host: WireHost,
    folder: tempfile::TempDir,
    config: Config,
}

impl Bench {
    fn new(test: &str) -> Self {
        let address = WireAddress::new(&format!("r{test}{}", std::process::id()), 1);
        let host = WireHost::create(&address, shape()).unwrap();
        Self { address, _host: host, folder: tempfile::tempdir().unwrap(), config: Config::default() }
    }

    fn start(&self) -> Recorder {
        self.start_as(1)
    }

    fn start_as(&self, incarnation: u32) -> Recorder {
        Recorder::start(RecorderSetup {
            address: self.address.clone(),
            shape: shape(),
            run_id: self.address.run_id().to_owned(),
            host: 0,
            ranks: 0..2,
            folder: RunFolder::new(self.folder.path()),
            incarnation,
            config: self.config.clone(),
        })
        .unwrap()
    }

    fn actors(&self) -> [FakeActor; 2] {
        [0, 1].map(|actor| FakeActor::join(&self.address, shape(), actor))
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        self.address.sweep().unwrap();
    }
}

/// Messages by topic.
fn messages(path: &Path) -> BTreeMap<String, Vec<Vec<u8>>> {
    let mut topics: HashMap<u16, String> = HashMap::new();
    let mut found: BTreeMap<String, Vec<Vec<u8>>> = BTreeMap::new();
    let extent = read::<RecordingError>(path, |record| {
        match record {
            McapRecord::Channel(channel) => drop(topics.insert(channel.id, channel.topic)),
            McapRecord::Message { header, data } => {
                found.entry(topics[&header.channel_id].clone()).or_default().push(data.into_owned());
            }
            _ => {}
        }
        Ok(())
    })
    .unwrap();
    assert_eq!(extent.end, FileEnd::Whole);
    found
}

#[test]
fn every_step_is_recorded_once_and_puts_its_episode_together() {
    let bench = Bench::new("once");
    let recorder = bench.start();
    let actors = bench.actors();
    let exchanges = 12;
    for step in 0..=exchanges {
        for actor in &actors {
            for half in 0..2 {
                let edit = |record: &mut Record| {
                    if record.header().environment == 2 {
                        record.header_mut().flags |= flag::RECORD_BULK;
                    }
                };
                actor.send(half, 1, step, edit);
                if step == 6 {
                    // A restarted actor repeats where it stands.
                    actor.send(half, 1, step, edit);
                }
            }
        }
    }
    recorder.stage_switch(None, 0, 0, 0);
    recorder.learner(
        1,
        &LearnerEvent::RolloutTrained {
            rank: 0,
            rollout: 0,
            frames: 72,
            stage: 0,
            timing: Timing { update_s: 2.0, ..Timing::default() },
            metrics: BTreeMap::from([(metric::ENTROPY.to_owned(), 3.0), ("auxiliary/recall".to_owned(), 0.5)]),
        },
    );
    assert_eq!(recorder.failure(), None);
    let summary = recorder.finish().unwrap();
    let environments = 6;
    assert_eq!(summary.steps, exchanges * environments);
    assert_eq!(summary.episodes, exchanges / u64::from(EPISODE_STEPS) * environments);
    assert_eq!(summary.depth_frames, 2 * (exchanges + 1));
    assert_eq!(summary.files.len(), 1);
    assert_eq!(summary.bytes, std::fs::metadata(&summary.files[0]).unwrap().len());

    let found = messages(&summary.files[0]);
    assert_eq!(found["/step"].len() as u64, summary.steps);
    assert_eq!(found["/episode/start"].len() as u64, 3 * environments);
    assert_eq!(found["/episode/end"].len() as u64, summary.episodes);
    assert_eq!(found["/depth/kitchen-01/2/image"].len() as u64, exchanges + 1);
    assert_eq!(found["/depth/kitchen-03/2/calibration"].len() as u64, exchanges + 1);
    assert_eq!(found["/tf"].len() as u64, summary.depth_frames);
    assert_eq!(found["/stage"].len(), 1);
    let metrics = LearnerMetrics::decode(found["/learner/metrics"][0].as_slice()).unwrap();
    assert_eq!((metrics.policy_entropy, metrics.other["auxiliary/recall"]), (Some(3.0), 0.5));
    let said = said(&summary.files[0], &ARM);
    let end = those(&said, Carries::End).next().unwrap();
    // Five steps of -0.01, 10 for success, and 15 × -0.002 a step more under r′.
    let returns: Vec<f64> = end.returns.iter().map(|sum| sum.unwrap()).collect();
    assert!((returns[0] - 9.95).abs() < 1e-5 && (returns[1] - 9.8).abs() < 1e-5, "{returns:?}");
    let metric = |name: &str| end.metrics[ARM.spec.metrics.iter().position(|metric| metric.name == name).unwrap()];
    assert_eq!(metric("success"), Some(1.0));
    assert_eq!(metric("success_without_disturbance"), Some(0.0), "five steps of 2 mm are 10 mm");

    let recorded = gather(&summary.files, Wanted::default()).unwrap();
    assert_eq!(recorded.episodes.len() as u64, 3 * environments);
    assert_eq!(proto::config::Config::from_toml(&recorded.configs[0], "recording").unwrap(), bench.config);
    for episode in &recorded.episodes {
        let steps = episode.actions.len() as u32;
        assert_eq!(steps, if episode.episode == 2 { 2 } else { EPISODE_STEPS });
        assert_eq!(episode.start_hash, Some(hash(episode.episode, 0)));
        let actions: Vec<u8> = (0..steps).map(|step| action(episode.episode, step) as u8).collect();
        let hashes: Vec<u64> = (0..steps).map(|step| hash(episode.episode, step + 1)).collect();
        assert_eq!((&episode.actions, &episode.hashes), (&actions, &hashes));
    }
}

#[test]
fn a_hold_is_not_recorded() {
    let bench = Bench::new("hold");
    let recorder = bench.start();
    let actors = bench.actors();
    let depth = |record: &mut Record| record.header_mut().flags |= flag::RECORD_BULK;
    for half in 0..2 {
        actors[0].send(half, 1, 0, depth);
        // The same observation comes back, with no transition.
        actors[0].send(half, 1, 1, |record| {
            *record = testing::record(record.header().environment, 0, flag::RECORD_BULK);
        });
    }
    let summary = recorder.finish().unwrap();
    assert_eq!((summary.steps, summary.depth_frames), (0, 3));
    assert_eq!(messages(&summary.files[0])["/episode/start"].len(), 3);
}

/// Of a frame of which an actor wrote the sums alone, shared memory holds what an earlier one left.
#[test]
fn a_frame_that_is_not_there_is_not_recorded() {
    let bench = Bench::new("sums");
    let recorder = bench.start();
    let actors = bench.actors();
    for (step, parts) in (0..).zip([2, 2 | 1, 0, 1]) {
        actors[0].send(1, 1, step, |record| {
            record.header_mut().flags |= flag::RECORD_BULK;
            record.header_mut().bulk = parts;
        });
    }
    let summary = recorder.finish().unwrap();
    assert_eq!((summary.steps, summary.depth_frames), (3, 2));
}

#[test]
fn a_step_holds_the_observation_that_its_action_was_chosen_from() {
    let bench = Bench::new("goal");
    let recorder = bench.start();
    let [actor, _] = bench.actors();
    // The target is held from the third observation of each episode on.
    let send = |learner: u32, step: u64, shift_m: f32| {
        actor.send(1, learner, step, |record| {
            record.reals("wrist_to_object_m")[0] += shift_m;
            record.wholes("holding")[0] = u32::from(record.header().step >= 2);
        });
    };
    (0..=6).for_each(|step| send(1, step, 0.0));
    // The learner goes back to exchange 5, where episode 1 begins: what it saw then counts, not what was seen before.
    (5..=6).for_each(|step| send(2, step, 0.5));
    let summary = recorder.finish().unwrap();
    let said = said(&summary.files[0], &ARM);
    let seen = |told: &Told| {
        let numbers = |name: &str| ARM.spec.channel(name).unwrap().1.numbers(&told.record).collect::<Vec<_>>();
        told.seen.then(|| (numbers("wrist_to_object_m"), numbers("holding")))
    };
    let expected = |step: u32, shift_m: f32| {
        let wrist = [0.3 + shift_m, 0.01 * step as f32, 0.4].map(f64::from);
        Some((wrist.to_vec(), vec![f64::from(u8::from(step >= 2))]))
    };
    let all: Vec<_> = those(&said, Carries::Step).map(seen).collect();
    let expected: Vec<_> = [(0, 0.0), (1, 0.0), (2, 0.0), (3, 0.0), (4, 0.0), (0, 0.0), (0, 0.5)]
        .map(|(step, shift_m)| expected(step, shift_m))
        .into();
    assert_eq!(all, expected);
    assert!(said.iter().all(|(_, told)| told.engine.fixed_episode.is_none()), "a run has no fixed episodes");
}

/// A recorder that starts at a restore point has not seen what the action was chosen from.
#[test]
fn what_was_not_seen_is_not_recorded() {
    let bench = Bench::new("unseen");
    let recorder = bench.start();
    let [actor, _] = bench.actors();
    actor.send(1, 1, 0, |_| {});
    actor.send(1, 1, 1, |record| record.header_mut().acted_step = 1);
    let said = said(&recorder.finish().unwrap().files[0], &ARM);
    let step = those(&said, Carries::Step).next().unwrap();
    assert!(!step.seen && step.rewards[0] != 0.0);
}

#[test]
fn an_evaluations_episodes_have_the_numbers_of_its_table() {
    let mut bench = Bench::new("fixed");
    bench.config.evaluation = Some(EvaluationConfig::fixed(Split::Test, ObjectSet::Novel, 6));
    bench.config.actors = proto::config::ActorsConfig { count: 5, environments_per_actor: 3 };
    let recorder = bench.start();
    let [actor, _] = bench.actors();
    // Environment 2 of the first test kitchen: of the six novel episodes the third and the last are its.
    for step in 0..=2 * u64::from(EPISODE_STEPS) {
        actor.send(1, 1, step, |_| {});
    }
    let files = recorder.finish().unwrap().files;
    let plan = bench.config.evaluation_plan().unwrap();
    let kitchen = plan.episodes().next().expect("the plan has episodes").0;
    let id = proto::episode::EnvironmentId { kitchen, number: 2 };
    let [third, last] = [0, 1].map(|episode| plan.dealt(id, episode).unwrap());
    let said = said(&files[0], &ARM);
    let fixed = |carries| those(&said, carries).map(|told| told.engine.fixed_episode).collect::<Vec<_>>();
    assert_eq!(fixed(Carries::Start), [Some(third), Some(last), None]);
    assert_eq!(fixed(Carries::End), [Some(third), Some(last)]);
    let step = those(&said, Carries::Step).nth(5).unwrap();
    assert_eq!((step.engine.episode, step.engine.fixed_episode), (1, Some(last)));

    let wanted = Wanted { kitchen: Some(kitchen), episodes: vec![last], ..Wanted::default() };
    let recorded = gather(&files, wanted.clone()).unwrap();
    assert_eq!(recorded.episodes.iter().map(|episode| episode.episode).collect::<Vec<_>>(), [1]);
    assert_eq!(recorded.known.episodes.iter().copied().collect::<Vec<_>>(), [third, last]);
    assert!(wanted.check(&recorded.known).is_ok());
    let wrong = Wanted { episodes: vec![last + 1], ..Wanted::default() };
    let refused = wrong.check(&gather(&files, wrong.clone()).unwrap().known).unwrap_err().to_string();
    assert!(refused.ends_with(&format!("the last is {last}")), "{refused}");
}

#[test]
fn an_actor_restarted_during_a_hold_repeats_no_step() {
    let bench = Bench::new("hold2");
    let recorder = bench.start();
    let [actor, _] = bench.actors();
    // Sent as exchange `step`, it describes where the environment stood after `exchange` actions.
    let repeat = |step: u64, learner: u32, exchange: u64| {
        actor.send(1, learner, step, |record| {
            *record = testing::record(record.header().environment, exchange, 0);
        });
    };
    let last = u64::from(EPISODE_STEPS);
    for step in 0..=last {
        actor.send(1, 1, step, |_| {});
    }
    // HOLD, and an actor that was rebuilt sends the last action again: the one that ended the episode.
    repeat(last + 1, 1, last);
    repeat(last + 2, 1, last + 1);
    // The learner goes back to before this point, and the HOLD comes right after its restore point.
    repeat(last, 2, last);
    repeat(last + 1, 2, last);
    repeat(last + 2, 2, last + 1);
    let summary = recorder.finish().unwrap();
    assert_eq!((summary.steps, summary.episodes), (last + 2, 1));
}

#[test]
fn files_may_be_given_in_any_order_and_under_any_name() {
    let mut bench = Bench::new("order");
    bench.config.recording.segment_bytes = 20_000;
    let recorder = bench.start();
    let [actor, _] = bench.actors();
    for step in 0..=30 {
        for half in 0..2 {
            actor.send(half, 1, step, |record| record.header_mut().flags |= flag::RECORD_BULK);
        }
    }
    let files = recorder.finish().unwrap().files;
    assert!(files.len() > 2, "{files:?}");
    let in_order = gather(&files, Wanted::default()).unwrap();
    let moved: Vec<PathBuf> = (0..files.len()).map(|i| files[i].with_file_name(format!("{}.mcap", 99 - i))).collect();
    for (from, to) in files.iter().zip(&moved) {
        std::fs::rename(from, to).unwrap();
    }
    let backwards: Vec<PathBuf> = moved.into_iter().rev().collect();
    let recorded = gather(&backwards, Wanted::default()).unwrap();
    assert_eq!((recorded.broken, recorded.headless), (0, 0));
    assert_eq!(recorded.episodes, in_order.episodes);
    assert_eq!(recorded.episodes.len(), 3 * 6);
}

#[test]
fn a_rewind_is_recorded_again_and_readers_take_the_newest() {
    let bench = Bench::new("rewind");
    let recorder = bench.start();
    let [actor, _] = bench.actors();
    for step in 0..=9 {
        actor.send(1, 1, step, |_| {});
    }
    // The learner comes back at exchange 7 = episode 1, step 2; other actions follow.
    for step in 7..=8 {
        actor.send(1, 2, step, |record| {
            *record.action() = 20;
            record.header_mut().outcome_hash = step;
        });
    }
    // Still on the way from before.
    actor.send(1, 1, 10, |_| {});
    let busy = repair(&RunFolder::new(bench.folder.path()).recording(1, 0), None).unwrap_err().to_string();
    assert!(busy.contains("is still being written"), "{busy}");
    let summary = recorder.finish().unwrap();
    assert_eq!(summary.steps, 9 + 1);
    let said = said(&summary.files[0], &ARM);
    let last = those(&said, Carries::Step).last().unwrap().engine;
    assert_eq!((last.learner_incarnation, last.exchange, last.kitchen, last.environment), (2, 8, 1, 2));

    let recorded = gather(&summary.files, Wanted { episodes: vec![1], ..Wanted::default() }).unwrap();
    assert_eq!(recorded.episodes.len(), 1);
    assert_eq!(recorded.episodes[0].actions, [action(1, 0) as u8, action(1, 1) as u8, 20]);
    assert_eq!(recorded.episodes[0].hashes[2], 8);
}

#[test]
fn a_full_segment_is_completed_and_episodes_span_segments() {
    let mut bench = Bench::new("segments");
    bench.config.recording.segment_bytes = 20_000;
    let recorder = bench.start();
    let actors = bench.actors();
    for step in 0..=20 {
        for actor in &actors {
            actor.send(0, 1, step, |record| {
                record.header_mut().flags |= flag::RECORD_BULK;
                // Incompressible, so that chunks reach the disk soon.
                let mut state = step + 1;
                for pixel in record.depth_mm() {
                    state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                    *pixel = (state >> 49) as u16;
                }
            });
        }
    }
    let summary = recorder.finish().unwrap();
    assert!(summary.files.len() > 2, "{:?}", summary.files);
    assert_eq!(summary.bytes, summary.files.iter().map(|file| std::fs::metadata(file).unwrap().len()).sum::<u64>());
    assert_eq!(crate::recording::files_at(bench.folder.path()).unwrap(), summary.files);
    let steps: usize = summary.files.iter().map(|file| messages(file).get("/step").map_or(0, Vec::len)).sum();
    assert_eq!((steps as u64, summary.steps), (80, 80));
    let recorded = gather(&summary.files, Wanted::default()).unwrap();
    assert_eq!((recorded.headless, recorded.broken), (0, 0));
    assert_eq!(recorded.episodes.iter().map(|episode| episode.actions.len()).sum::<usize>(), 80);
    // The last alone begins in the middle of episodes.
    let last = gather(&summary.files[summary.files.len() - 1..], Wanted::default()).unwrap();
    assert!(last.episodes.iter().map(|episode| episode.actions.len()).sum::<usize>() < 80);
}

#[test]
fn a_recording_that_exists_is_never_overwritten() {
    let bench = Bench::new("exists");
    let path = RunFolder::new(bench.folder.path()).recording(1, 0);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(&path, b"precious").unwrap();
    let error = Recorder::start(RecorderSetup {
        address: bench.address.clone(),
        shape: shape(),
        run_id: bench.address.run_id().to_owned(),
        host: 0,
        ranks: 0..2,
        folder: RunFolder::new(bench.folder.path()),
        incarnation: 1,
        config: bench.config.clone(),
    })
    .unwrap_err()
    .to_string();
    assert!(error.contains("incarnation-001.000.mcap"), "{error}");
    assert_eq!(std::fs::read(&path).unwrap(), b"precious");
}

#[test]
fn a_failed_write_is_reported_and_actors_never_block() {
    let mut bench = Bench::new("full");
    // The second segment cannot be created: its name is taken.
    bench.config.recording.segment_bytes = 1;
    let second = RunFolder::new(bench.folder.path()).recording(1, 1);
    std::fs::create_dir_all(second.parent().unwrap()).unwrap();
    std::fs::write(&second, b"").unwrap();
    let recorder = bench.start();
    let actors = bench.actors();
    // Far more than the subscriber's buffer holds: `send` would block for good.
    for step in 0..40 {
        actors[0].send(0, 1, step, |_| {});
    }
    let deadline = std::time::Instant::now() + Duration::from_secs(10);
    while recorder.failure().is_none() {
        assert!(std::time::Instant::now() < deadline, "the failure is never reported");
        std::thread::sleep(Duration::from_millis(5));
    }
    let failure = recorder.failure().unwrap();
    assert!(failure.contains("incarnation-001.001.mcap") && failure.contains("recording.enabled = false"), "{failure}");
    assert_eq!(recorder.finish().unwrap_err().to_string(), failure);
}

/// A small recording, made once: its bytes.
fn recording() -> &'static [u8] {
    static BYTES: std::sync::OnceLock<Vec<u8>> = std::sync::OnceLock::new();
    BYTES.get_or_init(|| {
        let bench = Bench::new("cut");
        let recorder = bench.start();
        let [actor, _] = bench.actors();
        for step in 0..=40 {
            actor.send(1, 1, step, |record| record.header_mut().flags |= flag::RECORD_BULK);
        }
        let summary = recorder.finish().unwrap();
        std::fs::read(&summary.files[0]).unwrap()
    })
}

fn all_messages(path: &Path) -> (Vec<Vec<u8>>, FileEnd) {
    let mut found = Vec::new();
    let extent = read::<RecordingError>(path, |record| {
        if let McapRecord::Message { data, .. } = record {
            found.push(data.into_owned());
        }
        Ok(())
    })
    .unwrap();
    assert_eq!(extent.messages as usize, found.len());
    (found, extent.end)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    /// Wherever a kill or a full disk cuts a file: it reads as a prefix, and recover makes a whole file of just that.
    #[test]
    fn a_cut_file_is_a_prefix_and_can_be_repaired(cut in 0.0f64..1.0) {
        let whole = recording();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        std::fs::write(&path, whole).unwrap();
        let (all, end) = all_messages(&path);
        prop_assert_eq!(end, FileEnd::Whole);
        let length = 8 + (cut * (whole.len() - 9) as f64) as usize;
        std::fs::write(&path, &whole[..length]).unwrap();
        let (some, end) = all_messages(&path);
        prop_assert_eq!(end, FileEnd::Cut);
        prop_assert!(all.starts_with(&some));
        match repair(&path, None).unwrap() {
            Repair::Repaired { kept: Some(kept), extent, .. } => {
                prop_assert_eq!(extent.messages as usize, some.len());
                prop_assert_eq!(std::fs::read(kept).unwrap(), &whole[..length]);
            }
            other => prop_assert!(false, "{:?}", other),
        }
        prop_assert_eq!(all_messages(&path), (some, FileEnd::Whole));
        let again = repair(&path, None).unwrap();
        prop_assert_eq!(again, Repair::NotNeeded { messages: all_messages(&path).0.len() as u64 });
    }

    /// Whatever a disk does to a file: reading it neither panics nor invents messages without a word.
    #[test]
    fn a_damaged_file_never_yields_what_was_not_written(
        damage in prop::collection::vec((0.0f64..1.0, 1u8..), 1..4),
    ) {
        let whole = recording();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        std::fs::write(&path, whole).unwrap();
        let (all, _) = all_messages(&path);
        let mut bytes = whole.to_vec();
        for (place, mask) in damage {
            let index = 8 + (place * (whole.len() - 8) as f64) as usize;
            bytes[index] ^= mask;
        }
        std::fs::write(&path, &bytes).unwrap();
        let mut invented = 0;
        let extent = read_with_trust::<RecordingError>(&path, |record, trust| {
            if let McapRecord::Message { data, .. } = record {
                invented += u32::from(trust == salvage::Trust::Sound && !all.contains(&data.into_owned()));
            }
            Ok(())
        });
        // What comes from a chunk that was altered is called doubtful; a file that has such a thing is not whole.
        prop_assert!(invented == 0 || extent.is_ok_and(|extent| !extent.account.is_lossless()));
        let _ = gather(&[path], Wanted::default());
    }
}

#[test]
fn a_repair_replaces_no_file_of_the_user() {
    let whole = recording();
    let folder = tempfile::tempdir().unwrap();
    let (path, output, cut) = (folder.path().join("a.mcap"), folder.path().join("b"), folder.path().join("a.mcap.cut"));
    std::fs::write(&path, &whole[..whole.len() / 2]).unwrap();
    for existing in [&output, &cut] {
        std::fs::write(existing, "precious").unwrap();
    }
    for refused in [repair(&path, Some(&output)), repair(&path, Some(&path)), repair(&path, None)] {
        assert!(refused.unwrap_err().to_string().contains("exists: move it away"));
    }
    for existing in [&output, &cut] {
        assert_eq!(std::fs::read_to_string(existing).unwrap(), "precious");
    }
    assert_eq!(std::fs::read(&path).unwrap(), &whole[..whole.len() / 2]);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 3, "nothing is left behind");
    // Nor does it write through a link that lies where it writes first.
    std::os::unix::fs::symlink(&output, folder.path().join("c.partial")).unwrap();
    repair(&path, Some(&folder.path().join("c"))).unwrap();
    assert_eq!(std::fs::read_to_string(&output).unwrap(), "precious");
}

#[test]
fn what_is_no_recording_is_said_to_be_none() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let message = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        gather(std::slice::from_ref(&path), Wanted::default()).unwrap_err().to_string()
    };
    assert!(message(b"").ends_with("is empty: no recording"));
    assert!(message(b"MCAP").contains("is not an MCAP recording"));
    assert!(message(b"not a recording at all").contains("is not an MCAP recording"));
    let mut foreign = Vec::new();
    let mut writer = mcap::Writer::new(std::io::Cursor::new(&mut foreign)).unwrap();
    writer.add_channel(0, "/camera", "json", &BTreeMap::new()).unwrap();
    writer.finish().unwrap();
    drop(writer);
    assert!(message(&foreign).contains("was not written by this program"));
    let missing = gather(&[folder.path().join("b.mcap")], Wanted::default()).unwrap_err().to_string();
    assert!(missing.contains("cannot read") && missing.contains("b.mcap"), "{missing}");
    assert!(crate::recording::files_at(folder.path()).is_ok());
    // A start that was killed before its recorder had written anything takes nothing from the others.
    let nothing = folder.path().join("b.mcap");
    std::fs::write(&nothing, b"").unwrap();
    assert_eq!(crate::recording::files_at(folder.path()).unwrap(), std::slice::from_ref(&path));
    std::fs::remove_file(&path).unwrap();
    assert_eq!(crate::recording::files_at(folder.path()).unwrap(), [nothing], "its own error tells more");
    let empty = tempfile::tempdir().unwrap();
    assert!(crate::recording::files_at(empty.path()).unwrap_err().to_string().contains("holds no recordings"));
}
