//! What is written is whole.

use dataset::{About, DatasetError, Episode, Frames, Seen, Source, Step, Writer};
use simulator::tasks::arm_point_nav::Transition;
use std::path::Path;

const SIDE: usize = 8;

fn episode(steps: usize) -> Episode {
    let frames = vec![vec![7; SIDE * SIDE * 2]; steps + 1];
    let depth = Frames { name: "depth", side: SIDE, is_depth: true, frames };
    let about =
        About { kitchen: 1, environment: 0, number: 0, fixed: None, target: "Mug", outcome: "failure", seed: 1 };
    let seen = vec![Seen { goal_m: [0.0; 3], previous_action: 0, state_hash: 0 }; steps + 1];
    let steps = vec![Step { action: 1, transition: Transition::default(), end: None, rewards: [0.0; 2] }; steps];
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
fn a_folder_is_there_whole_or_not_at_all() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let mut writer = Writer::create(&out, source()).unwrap();
    writer.add(&episode(2)).unwrap();
    assert_eq!(names(folder.path()), ["out.partial"]);
    let second = Writer::create(&out, source()).err();
    assert!(matches!(second, Some(DatasetError::Partial(_))), "{second:?}");
    assert_eq!(names(folder.path()), ["out.partial"], "the second export removes nothing");
    drop(writer);
    assert!(names(folder.path()).is_empty());

    let mut writer = Writer::create(&out, source()).unwrap();
    writer.add(&episode(2)).unwrap();
    writer.finish().unwrap();
    assert_eq!(names(&out), ["README.md", "config.toml", "episode-000000.npz"]);
    let second = Writer::create(&out, source()).err();
    assert!(matches!(second, Some(DatasetError::Exists(_))), "{second:?}");
    assert_eq!(names(folder.path()), ["out"]);
}
