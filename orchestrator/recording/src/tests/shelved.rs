//! The episode index that grows with recordings has what a reading of them all gathers.

use super::{RecordingsFolder, Said, episodes, same, step};
use crate::episode_index::EpisodeIndex;
use crate::episodes::gather;
use crate::wanted::Wanted;
use proto::config::{Config, KitchenSource};
use proto::episode::EnvironmentId;
use proto::replay::RecordedEpisode;
use proto::run_folder::RunFolder;
use std::path::PathBuf;
use std::time::Duration;

const PATIENCE: Duration = Duration::from_mins(1);

/// Every episode that the episode index can take out.
fn all(shelf: &EpisodeIndex) -> Vec<RecordedEpisode> {
    let keys: Vec<_> = shelf.episodes().filter(|(_, shelved)| shelved.is_playable()).map(|(key, _)| key).collect();
    keys.into_iter().map(|key| shelf.take_out(key).unwrap().expect("it is on the shelf").1).collect()
}

fn gathered(files: &[PathBuf]) -> Vec<RecordedEpisode> {
    gather(files, Wanted::default()).unwrap().episodes
}

#[test]
fn episodes_over_two_files_are_found_as_the_files_appear() {
    let folder = RecordingsFolder::new();
    let mut shelf = EpisodeIndex::of(RunFolder::new(folder.0.path()));
    assert!(shelf.advance(PATIENCE) && shelf.episodes().count() == 0);
    let said = episodes(1);
    // Cut in the middle of episode 1.
    let cut = said.iter().position(step(1, 1)).unwrap();
    let first = folder.segment(0, &Config::default(), &said[..cut], same);
    assert!(shelf.advance(PATIENCE));
    assert_eq!(all(&shelf), gathered(std::slice::from_ref(&first)));
    let second = folder.segment(1, &Config::default(), &said[cut..], same);
    assert!(shelf.advance(PATIENCE));
    assert_eq!(all(&shelf), gathered(&[first, second]));
    let told: Vec<_> =
        shelf.episodes().map(|((_, _, episode), shelved)| (episode, shelved.steps, shelved.end.is_some())).collect();
    assert_eq!(told, [(0, 3, true), (1, 3, true), (2, 3, true), (3, 2, false)]);
    assert_eq!((shelf.last_of(1, 0), shelf.last_of(2, 0)), (Some((1, 0, 3)), None));
    assert!((shelf.indexed() - 1.0).abs() < 1e-9 && shelf.notes.is_empty());
    assert_eq!(shelf.newest_of(1, 2).map(|shelved| shelved.order).collect::<Vec<_>>(), [3, 2]);
    let first = shelf.episodes().next().unwrap().1;
    assert_eq!((first.target.as_deref(), first.end.as_ref().unwrap().outcome.as_str()), (Some("Apple"), "failure"));
    // As its messages have it, over both files.
    let shown = shelf.told((1, 0, 1)).unwrap().expect("it is on the shelf");
    assert_eq!((shown.moments.len(), shown.outcome.as_str()), (4, "failure"));
    let acted: Vec<bool> = shown.moments.iter().map(|moment| moment.action.is_some()).collect();
    assert_eq!(acted, [false, true, true, true]);
    assert!(shown.moments[3].rewards.contains_key("r") && shown.moments[3].channels.contains_key("disturbance_m"));
    assert!(shelf.told((1, 0, 9)).unwrap().is_none());
}

#[test]
fn an_episode_is_of_the_stage_in_which_its_last_step_was_taken() {
    let folder = RecordingsFolder::new();
    let said = episodes(1);
    let cut = said.iter().position(step(1, 1)).unwrap();
    let rewards = |folder: &RecordingsFolder| {
        let mut shelf = EpisodeIndex::of(RunFolder::new(folder.0.path()));
        assert!(shelf.advance(PATIENCE));
        shelf.episodes().map(|(_, shelved)| shelved.reward.as_deref().map(str::to_owned)).collect::<Vec<_>>()
    };
    folder.staged(0, &Config::default(), &said[..cut], same, Some("r"), 0);
    assert_eq!(rewards(&folder), [Some("r".to_owned()), Some("r".to_owned())]);
    folder.staged(1, &Config::default(), &said[cut..], same, Some("r_prime"), 1000);
    assert_eq!(rewards(&folder), ["r", "r_prime", "r_prime", "r_prime"].map(|reward| Some(reward.to_owned())));

    // Another host records no stages, and its files are read after those of host 0.
    let folder = RecordingsFolder::new();
    folder.staged(0, &Config::default(), &[], same, Some("r"), 0);
    folder.staged(1, &Config::default(), &[], same, Some("r_prime"), 1000);
    folder.staged(2, &Config::default(), &said, same, None, 0);
    assert!(rewards(&folder).iter().all(|reward| reward.as_deref() == Some("r")) && rewards(&folder).len() == 4);
}

#[test]
fn what_a_newer_learner_went_back_behind_is_void() {
    let folder = RecordingsFolder::new();
    let mut said: Vec<Said> = episodes(1);
    said.extend(episodes(2).into_iter().filter(step(1, 1)));
    let file = folder.segment(0, &Config::default(), &said, same);
    let mut shelf = EpisodeIndex::of(RunFolder::new(folder.0.path()));
    assert!(shelf.advance(PATIENCE));
    let told: Vec<_> = shelf.episodes().map(|((_, _, episode), shelved)| (episode, shelved.steps)).collect();
    assert_eq!(told, [(0, 3), (1, 2)], "episodes 2 and 3 are void, and step 2 of episode 1");
    let taken = shelf.take_out((1, 0, 1)).unwrap().unwrap().1;
    assert_eq!(taken, gathered(&[file]).remove(1));
}

/// Void episodes were known by the kitchen, and those in kitchens to which the environment had not come back counted.
#[test]
fn episodes_are_void_in_whichever_kitchen_they_were() {
    let mut config = Config::default();
    (config.kitchens.source, config.kitchens.episodes_each) = (KitchenSource::Procedural, 1);
    let home = EnvironmentId::among(config.kitchens(), 0, 0, 1);
    let kitchen = |episode| config.kitchen_schedule().place(home, episode).kitchen.number();
    let mut said = episodes(1);
    said.extend(episodes(2).into_iter().filter(step(1, 1)));
    for (_, told) in &mut said {
        told.engine.kitchen = kitchen(told.engine.episode);
    }
    let folder = RecordingsFolder::new();
    let file = folder.segment(0, &config, &said, same);
    let mut shelf = EpisodeIndex::of(RunFolder::new(folder.0.path()));
    assert!(shelf.advance(PATIENCE));
    let mut counted: Vec<_> = shelf.episodes().map(|((_, _, episode), _)| episode).collect();
    counted.sort_unstable();
    assert_eq!(counted, [0, 1], "episodes 2 and 3 are void");
    assert_eq!(gathered(&[file]).len(), 2);
    assert_eq!(shelf.newest_of(kitchen(2), 1).count(), 0);
    assert_eq!((shelf.last_of(kitchen(1), 0), shelf.last_of(kitchen(3), 0)), (Some((kitchen(1), 0, 1)), None));
}

#[test]
fn a_damaged_file_is_read_up_to_its_damage_and_named() {
    let folder = RecordingsFolder::new();
    let file = folder.segment(0, &Config::default(), &episodes(1), same);
    let mut bytes = std::fs::read(&file).unwrap();
    // The one chunk's content: its last bytes are before the index.
    let chunk = bytes.windows(4).rposition(|window| window == [0x28, 0xb5, 0x2f, 0xfd]).unwrap();
    bytes[chunk + 20] ^= 0xff;
    std::fs::write(&file, bytes).unwrap();
    let mut shelf = EpisodeIndex::of(RunFolder::new(folder.0.path()));
    assert!(shelf.advance(PATIENCE));
    assert_eq!(all(&shelf), []);
    let expected = format!("orchestrator recover {}", file.display());
    assert!(shelf.notes.len() == 1 && shelf.notes[0].contains(&expected), "{:?}", shelf.notes);
    assert!(shelf.advance(PATIENCE) && shelf.notes.len() == 1, "it is said once");
}
