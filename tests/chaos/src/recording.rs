//! What the recordings of a run hold, read by a reader of the harness's own: each step, start and end of an episode,
//! by what it is of, with every copy of it.

use anyhow::{Context, Result};
use mcap::read::Options;
use prost::Message;
use proto::run_folder::RunFolder;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Kitchen, environment, episode, step (0 for the starts and ends of episodes).
type Key = (u32, u32, u32, u32);

/// What is the same in every copy of a step: all but who was started how often.
#[derive(Clone, PartialEq, Message)]
struct Step {
    #[prost(uint32, tag = "1")]
    kitchen: u32,
    #[prost(uint32, tag = "2")]
    environment: u32,
    #[prost(uint32, tag = "5")]
    episode: u32,
    #[prost(uint32, tag = "6")]
    step: u32,
    #[prost(uint32, tag = "8")]
    incarnation: u32,
    #[prost(uint32, tag = "9")]
    learner_incarnation: u32,
    #[prost(int32, tag = "12")]
    action: i32,
    #[prost(int32, tag = "13")]
    target: i32,
    #[prost(bool, tag = "14")]
    action_failed: bool,
    #[prost(bool, tag = "15")]
    holding: bool,
    #[prost(bool, tag = "16")]
    picked_up: bool,
    #[prost(bool, tag = "17")]
    done: bool,
    #[prost(bool, tag = "18")]
    success: bool,
    #[prost(bool, tag = "19")]
    time_limit: bool,
    #[prost(bool, tag = "20")]
    ended: bool,
    #[prost(fixed64, tag = "21")]
    state_hash: u64,
    #[prost(float, tag = "22")]
    wrist_object_progress_m: f32,
    #[prost(float, tag = "23")]
    object_goal_progress_m: f32,
    #[prost(float, tag = "24")]
    disturbance_progress_m: f32,
    #[prost(float, tag = "25")]
    reward_r: f32,
    #[prost(float, tag = "26")]
    reward_r_prime: f32,
    #[prost(float, tag = "27")]
    disturbance_m: f32,
    #[prost(float, tag = "28")]
    peak_disturbance_m: f32,
    #[prost(uint32, tag = "29")]
    disturbed_objects: u32,
    #[prost(float, tag = "30")]
    wrist_object_m: f32,
    #[prost(float, tag = "31")]
    object_goal_m: f32,
    /// One of the two vectors of the goal sensor, as it was encoded; neither where the recorder had not seen the
    /// observation before.
    #[prost(bytes = "vec", optional, tag = "32")]
    wrist_to_object_m: Option<Vec<u8>>,
    #[prost(bytes = "vec", optional, tag = "33")]
    object_to_goal_m: Option<Vec<u8>>,
}

/// What is the same in every copy of an episode's start.
#[derive(Clone, PartialEq, Message)]
struct EpisodeStart {
    #[prost(uint32, tag = "1")]
    kitchen: u32,
    #[prost(uint32, tag = "2")]
    environment: u32,
    #[prost(uint32, tag = "3")]
    episode: u32,
    #[prost(int32, tag = "6")]
    target: i32,
    #[prost(fixed64, tag = "7")]
    state_hash: u64,
    #[prost(bool, tag = "8")]
    depth_recorded: bool,
    #[prost(float, tag = "9")]
    wrist_object_m: f32,
    #[prost(float, tag = "10")]
    object_goal_m: f32,
}

/// What is the same in every copy of an episode's end. (Returns are missing where a recording begins in its middle.)
#[derive(Clone, PartialEq, Message)]
struct EpisodeEnd {
    #[prost(uint32, tag = "1")]
    kitchen: u32,
    #[prost(uint32, tag = "2")]
    environment: u32,
    #[prost(uint32, tag = "3")]
    episode: u32,
    #[prost(int32, tag = "6")]
    target: i32,
    #[prost(uint32, tag = "7")]
    length: u32,
    #[prost(bool, tag = "8")]
    success: bool,
    #[prost(bool, tag = "9")]
    success_undisturbed: bool,
    #[prost(bool, tag = "10")]
    picked_up: bool,
    #[prost(bool, tag = "11")]
    time_limit: bool,
    #[prost(float, tag = "12")]
    disturbance_m: f32,
    #[prost(float, tag = "13")]
    peak_disturbance_m: f32,
    #[prost(uint32, tag = "14")]
    disturbed_objects: u32,
}

/// All that the files of a run hold of its episodes.
#[derive(Debug, Default)]
pub struct Recording {
    steps: BTreeMap<Key, Vec<Step>>,
    starts: BTreeMap<Key, Vec<EpisodeStart>>,
    ends: BTreeMap<Key, Vec<EpisodeEnd>>,
    /// Steps in the order of the files, each with who took it: (orchestrator's, learner's start).
    order: Vec<(Key, (u32, u32))>,
}

impl Recording {
    /// Of a run folder.
    pub fn read(folder: &RunFolder) -> Result<Self> {
        let mut recording = Self::default();
        for path in &files(folder) {
            recording.add(path).with_context(|| path.display().to_string())?;
        }
        Ok(recording)
    }

    fn add(&mut self, path: &Path) -> Result<()> {
        each_message(path, |topic, data| {
            match topic {
                "/step" => {
                    let step = Step::decode(data)?;
                    let key = step.key();
                    self.order.push((key, step.generation()));
                    let step = Step { incarnation: 0, learner_incarnation: 0, ..step };
                    self.steps.entry(key).or_default().push(step);
                }
                "/episode/start" => {
                    let start = EpisodeStart::decode(data)?;
                    let key = (start.kitchen, start.environment, start.episode, 0);
                    self.starts.entry(key).or_default().push(start);
                }
                "/episode/end" => {
                    let end = EpisodeEnd::decode(data)?;
                    self.ends.entry((end.kitchen, end.environment, end.episode, 0)).or_default().push(end);
                }
                _ => {}
            }
            Ok(())
        })
    }

    /// Different steps.
    pub fn steps(&self) -> u64 {
        self.steps.len() as u64
    }

    /// Steps of the run as it was in the end.
    pub fn steps_that_count(&self) -> u64 {
        count(self.order.clone())
    }

    /// What differs from an undisturbed run's: what is missing, what is there besides, what is other.
    pub fn differences(&self, reference: &Self) -> Vec<String> {
        let mut found = vec![];
        let with_goal = |copies: &[Step]| {
            let known = |step: &&Step| step.wrist_to_object_m.is_some() || step.object_to_goal_m.is_some();
            copies.iter().find(known).cloned()
        };
        let without = |step: &Step| Step { wrist_to_object_m: None, object_to_goal_m: None, ..step.clone() };
        let same_step = |one: &[Step], other: &[Step]| {
            one.iter().all(|step| without(step) == without(&other[0])) && with_goal(one) == with_goal(other)
        };
        compare("steps", &self.steps, &reference.steps, same_step, &mut found);
        let all = |one: &[EpisodeStart], other: &[EpisodeStart]| one.iter().all(|copy| copy == &other[0]);
        compare("starts of episodes", &self.starts, &reference.starts, all, &mut found);
        let all = |one: &[EpisodeEnd], other: &[EpisodeEnd]| one.iter().all(|copy| copy == &other[0]);
        compare("ends of episodes", &self.ends, &reference.ends, all, &mut found);
        found
    }
}

/// Steps of a run as it was in the end, of a recording of any length.
pub fn steps_that_count(folder: &RunFolder) -> Result<u64> {
    let mut order = vec![];
    for path in &files(folder) {
        each_message(path, |topic, data| {
            if topic == "/step" {
                let step = Step::decode(data)?;
                order.push((step.key(), step.generation()));
            }
            Ok(())
        })
        .with_context(|| path.display().to_string())?;
    }
    Ok(count(order))
}

/// Of steps that were taken again the newest counts, and those that were given up do not.
fn count(mut order: Vec<(Key, (u32, u32))>) -> u64 {
    // For each environment: its steps, and who took them.
    let mut environments: BTreeMap<(u32, u32), BTreeMap<(u32, u32), (u32, u32)>> = BTreeMap::new();
    order.sort_by_key(|&(key, generation)| (generation, key));
    for ((kitchen, environment, episode, step), generation) in order {
        let taken = environments.entry((kitchen, environment)).or_default();
        if taken.values().next_back().is_some_and(|newest| *newest < generation) {
            // A newer one went back to here: what came after it is void.
            drop(taken.split_off(&(episode, step)));
        }
        taken.insert((episode, step), generation);
    }
    environments.values().map(|taken| taken.len() as u64).sum()
}

fn files(folder: &RunFolder) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder.recordings()).into_iter().flatten().flatten();
    let mut files: Vec<_> = entries
        .map(|entry| entry.path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "mcap"))
        .collect();
    files.sort();
    files
}

fn each_message(path: &Path, mut take: impl FnMut(&str, &[u8]) -> Result<()>) -> Result<()> {
    let bytes = std::fs::read(path)?;
    // The start of a recording that was killed before its first flush.
    if bytes.is_empty() {
        return Ok(());
    }
    // A file that was cut off ends without the magic; what is before its end is held to be whole.
    for message in mcap::MessageStream::new_with_options(&bytes, Options::IgnoreEndMagic.into())? {
        let message = message?;
        take(&message.channel.topic, &message.data)?;
    }
    Ok(())
}

impl Step {
    fn key(&self) -> Key {
        (self.kitchen, self.environment, self.episode, self.step)
    }

    fn generation(&self) -> (u32, u32) {
        (self.incarnation, self.learner_incarnation)
    }
}

fn compare<T>(
    what: &str,
    ours: &BTreeMap<Key, Vec<T>>,
    theirs: &BTreeMap<Key, Vec<T>>,
    same: impl Fn(&[T], &[T]) -> bool,
    found: &mut Vec<String>,
) {
    let place = |(kitchen, environment, episode, step): &Key| format!("{kitchen}/{environment} {episode}:{step}");
    let some = |keys: &[&Key]| keys.iter().take(3).map(|key| place(key)).collect::<Vec<_>>().join(", ");
    let missing: Vec<_> = theirs.keys().filter(|key| !ours.contains_key(key)).collect();
    let besides: Vec<_> = ours.keys().filter(|key| !theirs.contains_key(key)).collect();
    let other = |(key, copies): &(&Key, &Vec<T>)| theirs.get(key).is_some_and(|their| !same(copies, their));
    let other: Vec<_> = ours.iter().filter(other).map(|(key, _)| key).collect();
    for (how, keys) in [("missing", missing), ("besides", besides), ("other", other)] {
        if !keys.is_empty() {
            found.push(format!("recorded {what}, {how}: {} of {} ({})", keys.len(), theirs.len(), some(&keys)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step(episode: u32, number: u32, hash: u64) -> Step {
        Step { kitchen: 1, environment: 0, episode, step: number, state_hash: hash, ..Default::default() }
    }

    fn recording(steps: &[Step]) -> Recording {
        let mut recording = Recording::default();
        for step in steps {
            recording.steps.entry((1, 0, step.episode, step.step)).or_default().push(step.clone());
        }
        recording
    }

    #[test]
    fn what_is_missing_besides_or_other_is_found() {
        let reference = recording(&[step(0, 0, 1), step(0, 1, 2)]);
        let twice = recording(&[step(0, 0, 1), step(0, 1, 2), step(0, 1, 2)]);
        assert!(twice.differences(&reference).is_empty());
        let hole = recording(&[step(0, 1, 2)]);
        assert!(hole.differences(&reference)[0].contains("steps, missing: 1 of 2 (1/0 0:0)"));
        let besides = recording(&[step(0, 0, 1), step(0, 1, 2), step(0, 2, 2)]);
        assert!(besides.differences(&reference)[0].contains("steps, besides: 1"));
        let other = recording(&[step(0, 0, 1), step(0, 1, 2), step(0, 1, 3)]);
        assert!(other.differences(&reference)[0].contains("steps, other: 1"));
    }

    #[test]
    fn a_goal_must_be_in_one_copy() {
        let goal = |step: Step, goal| Step { wrist_to_object_m: goal, ..step };
        let reference = recording(&[goal(step(0, 0, 1), Some(vec![1]))]);
        let once = recording(&[step(0, 0, 1), goal(step(0, 0, 1), Some(vec![1]))]);
        assert!(once.differences(&reference).is_empty());
        assert_eq!(recording(&[step(0, 0, 1)]).differences(&reference).len(), 1);
        assert_eq!(recording(&[goal(step(0, 0, 1), Some(vec![2]))]).differences(&reference).len(), 1);
    }

    #[test]
    fn steps_that_were_given_up_do_not_count() {
        let at = |episode, step, learner| ((1, 0, episode, step), (1, learner));
        let recording = Recording {
            // The second learner goes on from the first episode's step 1, and ends that one earlier.
            order: vec![at(0, 0, 1), at(0, 1, 1), at(0, 2, 1), at(1, 0, 1), at(0, 1, 2), at(1, 0, 2)],
            ..Default::default()
        };
        assert_eq!(recording.steps_that_count(), 3);
    }
}
