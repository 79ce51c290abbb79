//! A recording is a complete file while it grows.

use super::*;
use crate::recorder::segment::{self, Preamble, Segments};
use crate::repair::Repair;
use crate::schema::Schema;

/// What a program that seeks finds in a file: messages by topic, through the index at the file's end.
fn indexed(path: &Path) -> BTreeMap<String, usize> {
    let bytes = std::fs::read(path).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().expect("an index");
    let mut found: BTreeMap<String, usize> = BTreeMap::new();
    for chunk in &summary.chunk_indexes {
        for (channel, entries) in summary.read_message_indexes(&bytes, chunk).unwrap() {
            *found.entry(channel.topic.clone()).or_default() += entries.len();
        }
        assert!(summary.stream_chunk(&bytes, chunk).unwrap().all(|message| message.is_ok()));
    }
    let stats = summary.stats.as_ref().unwrap();
    assert_eq!(stats.message_count, found.values().sum::<usize>() as u64);
    assert_eq!((stats.attachment_count, stats.metadata_count), (1, 1));
    assert_eq!(stats.chunk_count as usize, summary.chunk_indexes.len());
    let attached = &summary.attachment_indexes[0];
    assert_eq!(mcap::read::attachment(&bytes, attached).unwrap().name, segment::CONFIG_ATTACHMENT);
    assert_eq!(mcap::read::metadata(&bytes, &summary.metadata_indexes[0]).unwrap().name, segment::IDENTITY_METADATA);
    found
}

#[test]
fn a_file_is_complete_after_every_flush_and_its_index_is_the_one_it_ends_with() {
    let temporary = tempfile::tempdir().unwrap();
    let preamble = Preamble { run_id: "live".to_owned(), host: 0, incarnation: 1, config: Config::default() };
    let mut segments = Segments::create(RunFolder::new(temporary.path()), preamble, 0).unwrap();
    let path = segments.files[0].clone();
    assert_eq!(indexed(&path), BTreeMap::new());
    let topics =
        [segments.topic("/step", &ARM.forms.step.schema()), segments.topic("/log", &Schema::of("foxglove.Log"))];
    let summary = || mcap::Summary::read(&std::fs::read(&path).unwrap()).unwrap().unwrap();
    for round in 0..5usize {
        for number in 0..=round {
            segments.write(topics[round % 2], (10 * round + number) as u64, &[round as u8; 40]).unwrap();
        }
        let (before, _) = all_messages(&path);
        segments.flush().unwrap();
        let (now, end) = all_messages(&path);
        assert_eq!((now.len(), end), (before.len() + round + 1, FileEnd::Whole));
        assert_eq!(indexed(&path).values().sum::<usize>(), now.len());
    }
    let live = summary();
    assert_eq!(
        (live.stats.as_ref().unwrap().message_start_time, live.stats.as_ref().unwrap().message_end_time),
        (0, 44)
    );
    // What a killed recorder leaves is the file as it was after the last flush.
    let left = temporary.path().join("left.mcap");
    std::fs::copy(&path, &left).unwrap();
    assert_eq!(indexed(&left).values().sum::<usize>(), 1 + 2 + 3 + 4 + 5);
    assert_eq!(repair(&left, None).unwrap(), Repair::NotNeeded { messages: 15 });
    segments.finish().unwrap();
    let finished = summary();
    assert_eq!(format!("{:?}", live.stats), format!("{:?}", finished.stats));
    assert_eq!(live.chunk_indexes, finished.chunk_indexes);
    assert_eq!(live.attachment_indexes, finished.attachment_indexes);
    assert_eq!(live.metadata_indexes, finished.metadata_indexes);
    assert_eq!((&live.channels, &live.schemas), (&finished.channels, &finished.schemas));
    assert_eq!(indexed(&path)["/step"], 1 + 3 + 5);
}
