//! Recordings as they grow, message by message.

use super::{ARM, Carries, RecordingsFolder, Said, episodes, same, step};
use crate::recording::follow::Follower;
use crate::recording::reading::Reading;
use proto::config::Config;
use proto::run_folder::RunFolder;
use std::time::Duration;

const PATIENCE: Duration = Duration::from_mins(1);

/// Episode and step of what was told on `/step`.
fn told(follower: &mut Follower) -> Vec<(u32, u32)> {
    let recorded = follower.read(PATIENCE);
    let steps = recorded.iter().filter(|recorded| recorded.topic.name == "/step");
    let place = |recorded: &view::feed::Recorded| {
        let told = Reading::of(&ARM.forms.step, &recorded.topic.schema).unwrap().read(&recorded.data).unwrap();
        (told.engine.episode, told.engine.step)
    };
    steps.map(place).collect()
}

fn of(said: &[Said]) -> Vec<(u32, u32)> {
    super::those(said, Carries::Step).map(|told| (told.engine.episode, told.engine.step)).collect()
}

#[test]
fn what_was_there_is_told_of_by_its_newest_and_what_is_new_wholly_over_several_files() {
    let folder = RecordingsFolder::new();
    let mut follower = Follower::of(RunFolder::new(folder.0.path()));
    assert!(told(&mut follower).is_empty(), "no file yet");
    let said = episodes(1);
    let first = said.iter().position(step(1, 1)).unwrap();
    let second = said.iter().position(step(2, 1)).unwrap();
    folder.segment(0, &Config::default(), &said[..first], same);
    assert_eq!(told(&mut follower), of(&said[..first])[of(&said[..first]).len() - 1..]);
    let topics = follower.topics();
    let names: Vec<&str> = topics.iter().map(|topic| topic.name.as_str()).collect();
    assert!(names.contains(&"/step") && names.is_sorted(), "{names:?}");
    assert!(topics.iter().all(|topic| topic.encoding == "protobuf"));
    assert!(told(&mut follower).is_empty(), "nothing twice");
    folder.segment(1, &Config::default(), &said[first..second], same);
    folder.segment(2, &Config::default(), &said[second..], same);
    assert_eq!(told(&mut follower), of(&said[first..]));
    assert!(told(&mut follower).is_empty());
}
