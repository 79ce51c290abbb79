//! The recorder against real shared memory, read back by the code that replays.

mod failures;
mod live;
mod made_up;
mod receipts;

use super::testing::{self, EPISODE_STEPS, FakeActor, Record, action, hash};
use super::{Recorder, RecorderSetup};
use crate::episodes::gather;
use crate::form::Carries;
use crate::reader::{FileEnd, RecordingError, read_with_trust};
use crate::repair::repair;
use crate::schema::stillroom::LearnerMetrics;
use crate::tests::read;
use crate::tests::{ARM, said, those};
use crate::wanted::Wanted;
use mcap::records::Record as McapRecord;
use proptest::prelude::*;
use prost::Message;
use proto::config::Config;
use proto::event::{LearnerEvent, Timing};
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
    assert_eq!(crate::files_at(bench.folder.path()).unwrap(), summary.files);
    let steps: usize = summary.files.iter().map(|file| messages(file).get("/step").map_or(0, Vec::len)).sum();
    assert_eq!((steps as u64, summary.steps), (80, 80));
    let recorded = gather(&summary.files, Wanted::default()).unwrap();
    assert_eq!((recorded.headless, recorded.broken), (0, 0));
    assert_eq!(recorded.episodes.iter().map(|episode| episode.actions.len()).sum::<usize>(), 80);
    // The last alone begins in the middle of episodes.
    let last = gather(&summary.files[summary.files.len() - 1..], Wanted::default()).unwrap();
    assert!(last.episodes.iter().map(|episode| episode.actions.len()).sum::<usize>() < 80);
    // In any order, under any name.
    let moved = (0..summary.files.len()).map(|i| summary.files[i].with_file_name(format!("{}.mcap", 99 - i)));
    let moved: Vec<PathBuf> = moved.collect();
    for (from, to) in summary.files.iter().zip(&moved) {
        std::fs::rename(from, to).unwrap();
    }
    let moved: Vec<PathBuf> = moved.into_iter().rev().collect();
    assert_eq!(gather(&moved, Wanted::default()).unwrap().episodes, recorded.episodes);
}

#[test]
fn a_failed_write_is_reported_and_actors_never_block() {
    let mut bench = Bench::new("full");
    // The second segment cannot be created: its name is taken.
    bench.config.recording.segment_bytes = 1;
    let second = RunFolder::new(bench.folder.path()).recording(1, 1);
    std::fs::create_dir_all(second.parent().unwrap()).unwrap();
    std::fs::write(&second, b"precious").unwrap();
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
    assert_eq!(std::fs::read(&second).unwrap(), b"precious");
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
    // Nor what has the names under which it writes first.
    std::fs::remove_file(&cut).unwrap();
    let partial = ["a.mcap.partial", "a.mcap.partial-2"].map(|name| folder.path().join(name));
    for existing in &partial {
        std::fs::write(existing, "precious").unwrap();
    }
    repair(&path, None).unwrap();
    for existing in &partial {
        assert_eq!(std::fs::read_to_string(existing).unwrap(), "precious");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 7, "nothing is left behind");
    gather(&[path], Wanted::default()).unwrap();
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
    assert!(crate::files_at(folder.path()).is_ok());
    // A start that was killed before its recorder had written anything takes nothing from the others.
    let nothing = folder.path().join("b.mcap");
    std::fs::write(&nothing, b"").unwrap();
    assert_eq!(crate::files_at(folder.path()).unwrap(), std::slice::from_ref(&path));
    std::fs::remove_file(&path).unwrap();
    assert_eq!(crate::files_at(folder.path()).unwrap(), [nothing], "its own error tells more");
    let empty = tempfile::tempdir().unwrap();
    assert!(crate::files_at(empty.path()).unwrap_err().to_string().contains("holds no recordings"));
}
