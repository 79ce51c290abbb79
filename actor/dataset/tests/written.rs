//! What is written is whole.

use dataset::{About, DatasetError, Episode, Frames, Moment, Source, Writer};
use proto::record::End;
use proto::task::Spec;
use std::io::Read;
use std::path::Path;

const SIDE: usize = 8;

/// A task that nobody has: its actions are numbers, it has no image.
const TASK: &str = r#"
name = "made_up"
actions = { kind = "box", bounds = [[-1.0, 1.0], [0.0, 2.0]] }
rewards = [{ name = "near", terms = [["nearer_m", 2.0]] }]
channels = [
    { name = "nearer_m", role = "part", dtype = "f32", range = [-1, 1], doc = "Nearer." },
    { name = "held", role = "outcome", dtype = "u8", values = [0, 1], doc = "Held." },
    { name = "kind", role = "outcome", dtype = "u8", names = ["square", "round"], doc = "What it is." },
    { name = "pair", role = "observation", dtype = "f64", shape = [2], range = [-1, 1], doc = "Two numbers." },
]
metrics = [{ name = "way_m", over = "sum", value = "nearer_m", doc = "All of the way." }]
"#;

fn episode(spec: &Spec, steps: usize) -> Episode {
    let frames = vec![vec![7; SIDE * SIDE * 2]; steps + 1];
    let depth = Frames { name: "depth".to_owned(), side: SIDE, is_depth: true, frames };
    let (outcome, metrics) = ("failure".to_owned(), vec![0.5; spec.metrics.len()]);
    let about = About { kitchen: 1, environment: 0, number: 0, fixed: None, outcome, metrics, seed: 1 };
    let moment = |number: usize| {
        let mut record = vec![0; spec.layout().small_bytes];
        record[spec.layout().seen.start..][..2].copy_from_slice(&[number as u8, 1]);
        record[spec.layout().action.offset] = number as u8;
        let end = (number == steps).then_some(End::Truncated);
        Moment { record, state_hash: number as u64, rewards: vec![number as f32], end }
    };
    Episode { about, moments: (0..=steps).map(moment).collect(), cameras: vec![depth] }
}

fn source(spec: &'static Spec) -> Source {
    let rewards = spec.rewards.iter().take(1).map(|reward| reward.name.clone()).collect();
    Source { spec, actions: vec![], numbers: vec![], rewards, configs: vec![String::new()] }
}

fn made_up() -> &'static Spec {
    Box::leak(Box::new(Spec::parse(TASK).expect("a task")))
}

/// Type, shape and bytes of an array of the first episode.
fn array(folder: &Path, name: &str) -> (String, Vec<u8>) {
    let file = std::fs::File::open(folder.join("episode-000000.npz")).expect("an archive");
    let mut bytes = vec![];
    let mut archive = zip::ZipArchive::new(file).expect("an archive");
    let mut entry = archive.by_name(&format!("{name}.npy")).expect("an array");
    entry.read_to_end(&mut bytes).expect("readable");
    let length = usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let head = String::from_utf8(bytes[10..10 + length].to_vec()).expect("text");
    (head.trim_end().to_owned(), bytes[10 + length..].to_vec())
}

#[test]
fn the_arrays_of_a_task_follow_from_its_declaration() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let spec = made_up();
    let mut writer = Writer::create(&out, source(spec)).unwrap();
    writer.add(&episode(spec, 3)).unwrap();
    writer.finish().unwrap();
    let described =
        |kind: &str, shape: &str| format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({shape}), }}");
    for (name, kind, shape) in [
        ("depth_mm", "<u2", "4, 8, 8,"),
        ("pair", "<f8", "4, 2,"),
        ("state_hash", "<u8", "4,"),
        ("previous_action", "<f4", "4, 2,"),
        ("action", "<f4", "3, 2,"),
        ("reward_near", "<f4", "3,"),
        ("nearer_m", "<f4", "3,"),
        ("held", "|b1", "3,"),
        ("kind", "|u1", "3,"),
        ("truncated", "|b1", "3,"),
        ("metric_way_m", "<f8", ""),
        ("kind_names", "<U6", "2,"),
        ("observation_names", "<U4", "1,"),
    ] {
        assert_eq!(array(&out, name).0, described(kind, shape), "{name}");
    }
    assert_eq!(array(&out, "pair").1[..2], [0, 1], "what is seen begins at the start");
    assert_eq!(array(&out, "action").1[0], 1, "actions begin after it");
    assert_eq!(array(&out, "truncated").1, [0, 0, 1]);
    let page = std::fs::read_to_string(out.join("README.md")).unwrap();
    for line in ["| pair | seen: Two numbers. |", "| held | Held. |", "| metric_way_m | All of the way. |"] {
        assert!(page.contains(line), "{page}");
    }
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
    let mut writer = Writer::create(&out, source(made_up())).unwrap();
    writer.add(&episode(made_up(), 2)).unwrap();
    assert_eq!(names(folder.path()), ["out.partial"]);
    let second = Writer::create(&out, source(made_up())).err();
    assert!(matches!(second, Some(DatasetError::Partial(_))), "{second:?}");
    assert_eq!(names(folder.path()), ["out.partial"], "the second export removes nothing");
    drop(writer);
    assert!(names(folder.path()).is_empty());

    let mut writer = Writer::create(&out, source(made_up())).unwrap();
    writer.add(&episode(made_up(), 2)).unwrap();
    writer.finish().unwrap();
    assert_eq!(names(&out), ["README.md", "config.toml", "episode-000000.npz"]);
    let second = Writer::create(&out, source(made_up())).err();
    assert!(matches!(second, Some(DatasetError::Exists(_))), "{second:?}");
    assert_eq!(names(folder.path()), ["out"]);
}
