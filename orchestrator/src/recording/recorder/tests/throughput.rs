//! How fast steps and depth frames are written: a measurement.

use super::super::message_writer::MessageWriter;
use super::super::segment::{Preamble, Segments};
use super::super::testing;
use crate::recording::declared::Declared;
use proto::config::Config;
use proto::record::{RecordHeader, flag};
use proto::run_folder::RunFolder;
use proto::shares::Shares;
use std::path::PathBuf;
use wire::message::Line;

/// `cargo test --release -p orchestrator throughput -- --ignored --nocapture`; with `KEEP_RECORDING=FOLDER` the file
/// stays, for `tests/reference/read_mcap.py`.
#[test]
#[ignore = "a measurement"]
fn throughput_of_the_scribe() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = std::env::var_os("KEEP_RECORDING").map_or_else(|| temporary.path().to_path_buf(), PathBuf::from);
    let config = Config::default();
    let preamble = Preamble { run_id: "throughput".to_owned(), host: 0, incarnation: 1, config: config.clone() };
    let shape = testing::shape(Shares::of_one(1), 16);
    for (name, flags, exchanges) in [("steps", 0, 20_000u64), ("depth frames", flag::RECORD_BULK, 100)] {
        let folder = RunFolder::new(folder.join(name));
        let segments = Segments::create(folder, preamble.clone(), 0).unwrap();
        let declared = Declared::of(&config).unwrap();
        let mut message_writer = MessageWriter::new(segments, shape, 1, &config, declared);
        let header = wire::message::ObservationHeader { learner_incarnation: 1, ..Default::default() };
        let mut half: Vec<_> = (0..8).flat_map(|environment| testing::record(environment, 0, flags).0).collect();
        let lines = half.len() / 8;
        let started = std::time::Instant::now();
        for step in 0..=exchanges {
            for (environment, record) in (0..).zip(half.chunks_exact_mut(lines)) {
                // Headers alone change: to make whole records takes longer than to write them.
                *RecordHeader::of_mut(Line::bytes_mut(record)) = testing::header(environment, step, flags);
            }
            let header = wire::message::ObservationHeader { step, ..header };
            message_writer.observations(step * 1_000_000, &header, &half, step > 0).unwrap();
        }
        message_writer.segments().finish().unwrap();
        let seconds = started.elapsed().as_secs_f64();
        let counts = message_writer.counts;
        let bytes = message_writer.segments().bytes();
        assert!(counts.steps > 0 && (flags == 0) == (counts.depth_frames == 0), "{name}");
        println!(
            "{name}: {:.0} steps/s, {:.0} depth frames/s, {:.1} bytes a step",
            counts.steps as f64 / seconds,
            counts.depth_frames as f64 / seconds,
            bytes as f64 / counts.steps as f64
        );
    }
}
