//! What is written is whole, and in files of a bounded size.

use dataset::{About, DatasetError, Episode, Frames, Seen, Source, Step, Writer};
use proto::dataset::DatasetFormat;
use proto::step::Transition;
use std::path::Path;

const SIDE: usize = 256;

/// An episode whose frames do not pack: noise.
fn episode(number: u32, steps: usize) -> Episode {
    let mut depth = Frames::new("depth", SIDE, true, true);
    let mut state = number.wrapping_add(1);
    for _ in 0..=steps {
        let mut noise = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as u8
        };
        depth.push((0..SIDE * SIDE * 2).map(|_| noise()).collect()).expect("a frame is packed");
    }
    let about = About { kitchen: 1, environment: 0, number, fixed: None, target: "Mug", outcome: "failure", seed: 1 };
    let seen = vec![Seen { goal_m: [0.0; 3], previous_action: 0, state_hash: 0 }; steps + 1];
    let steps = vec![Step { action: 1, transition: Transition::default(), rewards: [0.0; 2] }; steps];
    Episode { about, seen, steps, cameras: vec![depth] }
}

fn source() -> Source {
    Source { actions: vec!["A", "B"], configs: vec![String::new()] }
}

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).expect("a folder");
    let mut names: Vec<_> =
        entries.map(|entry| entry.expect("an entry").file_name().into_string().expect("a plain name")).collect();
    names.sort();
    names
}

#[test]
fn a_file_of_lerobot_is_followed_by_the_next_before_it_is_too_large() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let mut writer = Writer::create(&out, DatasetFormat::LeRobot, source()).unwrap();
    // 13 MB each.
    for number in 0..9 {
        writer.add(&episode(number, 100)).unwrap();
    }
    let size = writer.finish().unwrap();
    assert_eq!((size.episodes, size.steps), (9, 900));
    let files = names(&out.join("data/chunk-000"));
    assert_eq!(files, ["file-000.parquet", "file-001.parquet"]);
    for file in files {
        let bytes = std::fs::metadata(out.join("data/chunk-000").join(&file)).unwrap().len();
        assert!(bytes < 100 << 20, "{file} has {bytes} bytes");
    }
}

#[test]
fn a_folder_is_there_whole_or_not_at_all() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    for format in [DatasetFormat::LeRobot, DatasetFormat::Parquet, DatasetFormat::Npz] {
        let mut writer = Writer::create(&out, format, source()).unwrap();
        writer.add(&episode(0, 2)).unwrap();
        assert_eq!(names(folder.path()), ["out.partial"]);
        let second = Writer::create(&out, format, source()).err();
        assert!(matches!(second, Some(DatasetError::Partial(_))), "{second:?}");
        assert_eq!(names(folder.path()), ["out.partial"], "whoever comes second removes nothing");
        drop(writer);
        assert!(names(folder.path()).is_empty());
    }
    let mut writer = Writer::create(&out, DatasetFormat::Parquet, source()).unwrap();
    writer.add(&episode(0, 2)).unwrap();
    writer.finish().unwrap();
    assert_eq!(names(&out), ["README.md", "config.toml", "episodes.parquet", "steps.parquet"]);
    let second = Writer::create(&out, DatasetFormat::Parquet, source()).err();
    assert!(matches!(second, Some(DatasetError::Exists(_))), "{second:?}");
    assert_eq!(names(folder.path()), ["out"]);
}
