//! Episodes as `actor dataset` is given them.

use actor::harvest::run;
use anyhow::Result;
use proto::config::Config;
use proto::dataset::{DatasetAnswer, DatasetRequest, DatasetSetup};
use proto::episode::EnvironmentId;
use proto::kitchen::KitchenId;
use proto::replay::{Difference, RecordedEpisode};
use simulator::robot::action::Action;
use simulator::source;
use simulator::tasks::arm_point_nav::Environment;
use std::io::Read;
use std::path::Path;
use std::sync::Arc;

const WAY: [Action; 4] =
    [Action::RotateRightContinuous, Action::MoveAheadContinuous, Action::LookDown, Action::DoneMidLevel];

fn setup(out: &Path, episodes: u64) -> DatasetSetup {
    DatasetSetup {
        configs: vec![Config::default().to_toml()],
        folder: None,
        out: out.to_str().expect("text").to_owned(),
        pictures: Vec::new(),
        side_px: 224,
        keep: None,
        limit: None,
        episodes,
    }
}

/// Episodes with these numbers, with their states as the recorder would have recorded them.
fn episodes(numbers: std::ops::Range<u32>) -> Vec<RecordedEpisode> {
    let config = Config::default();
    let id = EnvironmentId { kitchen: KitchenId::new(1).expect("a kitchen"), number: 0 };
    let kitchen = Arc::new(source::of_run(id.kitchen, &config, Path::new("")).expect("it can be built"));
    let mut environment = Environment::new(kitchen, id, &config).expect("it can be made");
    let mut record = |episode: u32| {
        environment.start_episode(episode);
        let start_hash = Some(environment.state_hash());
        let hash = |&action: &Action| {
            environment.step(action);
            environment.state_hash()
        };
        let hashes = WAY.iter().map(hash).collect();
        let actions = WAY.iter().map(|action| action.index()).collect();
        let (digests, start) = (Vec::new(), Vec::new());
        RecordedEpisode { environment: id, episode, start_hash, actions, hashes, digests, start }
    };
    numbers.map(&mut record).collect()
}

fn answers(setup: &DatasetSetup, episodes: &[RecordedEpisode]) -> (Result<()>, Vec<DatasetAnswer>) {
    let mut input = serde_json::to_string(setup).expect("plain data");
    for recorded in episodes {
        let request = DatasetRequest { config: 0, recorded: recorded.clone() };
        input = format!("{input}\n{}", serde_json::to_string(&request).expect("plain data"));
    }
    let mut output = Vec::new();
    let outcome = run(input.as_bytes(), &mut output);
    let output = String::from_utf8(output).expect("text");
    (outcome, output.lines().map(|line| serde_json::from_str(line).expect("an answer")).collect())
}

fn is_empty(folder: &Path) -> bool {
    std::fs::read_dir(folder).expect("a folder").next().is_none()
}

#[test]
fn episodes_are_written_in_their_order_and_as_many_as_wanted() {
    let folder = tempfile::tempdir().unwrap();
    let mut all = episodes(0..7);
    // The recording ends before the episode does.
    all[2].actions.truncate(2);
    all[2].hashes.truncate(2);
    let out = folder.path().join("all");
    let (outcome, answers_of_all) = answers(&setup(&out, 7), &all);
    outcome.unwrap();
    let played = answers_of_all.iter().filter_map(|answer| match answer {
        DatasetAnswer::Simulated { verdict, kept, unfinished } => Some((verdict.episode, *kept, *unfinished)),
        _ => None,
    });
    let expected: Vec<_> = (0..7).map(|number| (number, number != 2, number == 2)).collect();
    assert_eq!(played.collect::<Vec<_>>(), expected);
    assert!(matches!(answers_of_all.last(), Some(DatasetAnswer::Written { episodes: 6, steps: 24, .. })));
    assert!(out.join("episode-000005.npz").exists() && !out.join("episode-000006.npz").exists());

    let limited = DatasetSetup { limit: Some(3), ..setup(&folder.path().join("three"), 7) };
    let (outcome, three) = answers(&limited, &all);
    outcome.unwrap();
    assert!(matches!(three.last(), Some(DatasetAnswer::Written { episodes: 3, steps: 12, .. })));

    let none = DatasetSetup { keep: Some("success".to_owned()), ..setup(&folder.path().join("none"), 7) };
    assert_eq!(answers(&none, &all).1.last(), Some(&DatasetAnswer::Nothing));
    assert!(!folder.path().join("none").exists() && !folder.path().join("none.partial").exists());
    let unknown = DatasetSetup { keep: Some("undisturbed".to_owned()), ..setup(&folder.path().join("none"), 7) };
    let refused = answers(&unknown, &all).0.unwrap_err().to_string();
    assert!(refused.contains("has success, success_without_disturbance,"), "{refused}");
}

#[test]
fn rewards_of_the_configuration_are_columns_as_the_tasks_are() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let own = "[[rewards]]\nname = \"r_failures\"\nconstant = 0.5\nterms = [[\"failed_action\", -2.0]]";
    let config = Config::resolve_with("paper", Some((own, "mine.toml"))).unwrap();
    let (outcome, _) = answers(&DatasetSetup { configs: vec![config.to_toml()], ..setup(&out, 1) }, &episodes(0..1));
    outcome.unwrap();
    let mut archive = zip::ZipArchive::new(std::fs::File::open(out.join("episode-000000.npz")).unwrap()).unwrap();
    let mut rows = |name: &str, row_bytes: usize| {
        let mut bytes = vec![];
        archive.by_name(&format!("{name}.npy")).unwrap().read_to_end(&mut bytes).unwrap();
        bytes.split_off(bytes.len() - row_bytes * WAY.len())
    };
    let number = |bytes: &[u8]| f32::from_le_bytes(bytes.try_into().unwrap());
    let rewards: Vec<f32> = rows("reward_r_failures", 4).chunks_exact(4).map(number).collect();
    let failed = rows("failed_action", 1);
    // Done was declared away from the goal; the first turn is free.
    assert_eq!((failed[0], failed[3]), (0, 1));
    assert_eq!(rewards, failed.iter().map(|&failed| 0.5 - 2.0 * f32::from(failed)).collect::<Vec<_>>());
    let page = std::fs::read_to_string(out.join("README.md")).unwrap();
    assert!(page.find("| reward_r_failures |").unwrap() < page.find("| reward_r_prime |").unwrap());
}

#[test]
fn nothing_is_written_of_what_the_simulator_does_not_give_nor_of_half_an_input() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let mut altered = episodes(0..3);
    altered[1].actions.swap(0, 1);
    let (outcome, told) = answers(&setup(&out, 3), &altered);
    outcome.unwrap();
    let Some(DatasetAnswer::Simulated { verdict, kept: false, .. }) = told.last() else { panic!("{told:?}") };
    assert_eq!(verdict.episode, 1);
    assert_eq!(verdict.first_difference, Some(Difference { step: 1, what: "state".to_owned() }));
    assert!(is_empty(folder.path()));

    let (outcome, _) = answers(&setup(&out, 3), &episodes(0..2));
    assert!(outcome.unwrap_err().to_string().contains("ended after 2 of 3 episodes"));
    assert!(is_empty(folder.path()));

    let mut impossible = episodes(0..2);
    impossible[1].actions[0] = 99;
    let (outcome, _) = answers(&setup(&out, 2), &impossible);
    assert!(format!("{:#}", outcome.unwrap_err()).contains("no action 99"));
    assert!(is_empty(folder.path()));
}
