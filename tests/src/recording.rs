//! What the recordings of a run hold, read without any code of the system: each step, start and end of an episode,
//! by what it is of, with every copy of it.

use crate::Run;
use anyhow::{Context, Result};
use mcap::read::Options;
use prost_reflect::{DescriptorPool, DynamicMessage, MessageDescriptor, ReflectMessage};
use proto::task::{Metric, Over, Spec};
use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};
use std::path::Path;

/// Kitchen, environment, episode, step (0 for the starts and ends of episodes).
type Key = (u32, u32, u32, u32);

/// Who was started how often, and what depends on it: not the same in every copy of a message.
const STARTS: [&str; 7] = [
    "actor",
    "environment_index",
    "exchange",
    "incarnation",
    "learner_incarnation",
    "actor_incarnation",
    "stage_version",
];

/// What a message says, but for who was started how often.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
struct Copy {
    /// What is in every copy.
    always: Vec<u8>,
    /// What may be absent: a recorder that was started in the middle of an episode has not seen it.
    sometimes: BTreeMap<String, String>,
}

impl Copy {
    fn of(mut message: DynamicMessage) -> Self {
        for name in STARTS {
            message.clear_field_by_name(name);
        }
        let fields: Vec<_> = message.descriptor().fields().collect();
        let mut sometimes = BTreeMap::new();
        for field in fields.iter().filter(|field| field.supports_presence() || field.is_list()) {
            if message.has_field(field) {
                sometimes.insert(field.name().to_owned(), message.get_field(field).to_string());
                message.clear_field(field);
            }
        }
        Self { always: prost_reflect::prost::Message::encode_to_vec(&message), sometimes }
    }
}

fn number(message: &DynamicMessage, name: &str) -> u32 {
    message.get_field_by_name(name).and_then(|value| value.as_u32()).unwrap_or_default()
}

fn key_of(message: &DynamicMessage) -> Key {
    let [kitchen, environment, episode, step] =
        ["kitchen", "environment", "episode", "step"].map(|name| number(message, name));
    (kitchen, environment, episode, step)
}

fn generation_of(message: &DynamicMessage) -> (u32, u32) {
    (number(message, "incarnation"), number(message, "learner_incarnation"))
}

/// All that the files of a run hold of its episodes.
#[derive(Debug, Default)]
pub struct Recording {
    steps: BTreeMap<Key, Vec<Copy>>,
    starts: BTreeMap<Key, Vec<Copy>>,
    ends: BTreeMap<Key, Vec<Copy>>,
    /// Steps in the order of the files, each with who took it: (orchestrator's, learner's start).
    order: Vec<(Key, (u32, u32))>,
    /// Each end, with who took the episode's last step, and how many it had.
    closed: Vec<(Key, (u32, u32), u32)>,
}

impl Recording {
    /// Of a run; an error if a file cannot be read.
    pub fn read(run: &Run) -> Result<Self> {
        let mut recording = Self::default();
        for path in &run.recordings() {
            recording.add(path).with_context(|| path.display().to_string())?;
        }
        Ok(recording)
    }

    /// Of a run whose files can be read.
    pub fn of(run: &Run) -> Self {
        Self::read(run).expect("readable recordings")
    }

    fn add(&mut self, path: &Path) -> Result<()> {
        each_message(path, is_of_episodes, |topic, message| {
            let key = key_of(&message);
            let copies = match topic {
                "/step" => {
                    self.order.push((key, generation_of(&message)));
                    &mut self.steps
                }
                "/episode/start" => &mut self.starts,
                _ => {
                    self.closed.push((key, generation_of(&message), number(&message, "length")));
                    &mut self.ends
                }
            };
            copies.entry(key).or_default().push(Copy::of(message));
        })
    }

    /// Different steps.
    pub fn steps(&self) -> u64 {
        self.steps.len() as u64
    }

    /// Steps, each as often as it was recorded.
    pub fn messages(&self) -> u64 {
        self.order.len() as u64
    }

    /// Kitchen, environment and number of the episodes that began.
    pub fn starts(&self) -> impl Iterator<Item = (u32, u32, u32)> {
        self.starts.keys().map(|&(kitchen, environment, episode, _)| (kitchen, environment, episode))
    }

    /// Where an environment's course breaks off and goes on later: each step follows the one before it in its episode,
    /// or begins the episode after one that ended.
    pub fn holes(&self) -> Vec<String> {
        let lasts = self.closed.iter().map(|&((kitchen, environment, episode, _), _, length)| {
            (kitchen, environment, episode, length.saturating_sub(1))
        });
        let lasts: HashSet<Key> = lasts.collect();
        let (mut holes, mut expected) = (vec![], BTreeMap::new());
        for key in self.steps.keys() {
            let &(kitchen, environment, episode, step) = key;
            let expected = expected.entry((kitchen, environment)).or_insert((0, 0));
            if (episode, step) != *expected {
                holes.push(format!("{kitchen}/{environment}: {expected:?} is missing before {:?}", (episode, step)));
            }
            *expected = if lasts.contains(key) { (episode + 1, 0) } else { (episode, step + 1) };
        }
        holes
    }

    /// Steps of the run as it was in the end.
    pub fn steps_that_count(&self) -> u64 {
        count(self.order.clone())
    }

    /// Ends of episodes whose steps were all taken by the same start of orchestrator and learner. Of others a recorder has
    /// not seen, or not for good, how they began.
    fn whole_episodes(&self) -> BTreeSet<Key> {
        let taken: HashSet<_> = self.order.iter().copied().collect();
        let is_whole = |&&((kitchen, environment, episode, _), generation, length): &&(Key, (u32, u32), u32)| {
            (0..length).all(|step| taken.contains(&((kitchen, environment, episode, step), generation)))
        };
        self.closed.iter().filter(is_whole).map(|&(key, ..)| key).collect()
    }

    /// What differs from an undisturbed run's: what is missing, what is there besides, what is other.
    pub fn differences(&self, reference: &Self) -> Vec<String> {
        let mut found = vec![];
        compare("steps", &self.steps, &reference.steps, |_, _| false, &mut found);
        compare("starts of episodes", &self.starts, &reference.starts, |_, _| false, &mut found);
        let whole = self.whole_episodes();
        let may_lack = |key: &Key, name: &str| !whole.contains(key) && is_of_all_steps(name);
        compare("ends of episodes", &self.ends, &reference.ends, may_lack, &mut found);
        found
    }
}

/// Whether a field of an episode's end is made of all steps, not of the last one alone: returns, and such metrics.
fn is_of_all_steps(name: &str) -> bool {
    let is_of_all = |metric: &Metric| metric.name == name && metric.over != Over::Last;
    // The score is of every task that is not built in.
    name.starts_with("return_")
        || name == "score"
        || Spec::built_in().iter().flat_map(|spec| &spec.metrics).any(is_of_all)
}

/// Steps of a run as it was in the end, of a recording of any length.
pub fn steps_that_count(run: &Run) -> Result<u64> {
    let mut order = vec![];
    for path in &run.recordings() {
        let take = |_: &str, message: DynamicMessage| order.push((key_of(&message), generation_of(&message)));
        each_message(path, |topic| topic == "/step", take).with_context(|| path.display().to_string())?;
    }
    Ok(count(order))
}

/// The recorded depth frames of a run, by topic, in the order in which they were written.
pub fn recorded_depth(run: &Run) -> BTreeMap<String, Vec<Vec<u8>>> {
    let mut frames: BTreeMap<String, Vec<Vec<u8>>> = BTreeMap::new();
    for path in &run.recordings() {
        let take = |topic: &str, image: DynamicMessage| {
            let data = image.get_field_by_name("data").and_then(|data| Some(data.as_bytes()?.to_vec()));
            frames.entry(topic.to_owned()).or_default().push(data.expect("an image"));
        };
        let is_image = |topic: &str| topic.starts_with("/depth/") && topic.ends_with("/image");
        each_message(path, is_image, take).expect("a readable recording");
    }
    frames
}

/// Of steps that were taken again the newest counts, and those that were given up do not.
fn count(mut order: Vec<(Key, (u32, u32))>) -> u64 {
    // For each environment: its steps, and who took them.
    #[allow(clippy::type_complexity)]
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

fn is_of_episodes(topic: &str) -> bool {
    ["/step", "/episode/start", "/episode/end"].contains(&topic)
}

/// Hands on every message on these topics, by the schemas that the file has of them.
fn each_message(
    path: &Path,
    is_wanted: impl Fn(&str) -> bool,
    mut take: impl FnMut(&str, DynamicMessage),
) -> Result<()> {
    let bytes = std::fs::read(path)?;
    // The start of a recording that was killed before its first flush.
    if bytes.is_empty() {
        return Ok(());
    }
    let mut kinds: HashMap<String, MessageDescriptor> = HashMap::new();
    // A file that was cut off ends without the magic; what is before its end is held to be whole.
    for message in mcap::MessageStream::new_with_options(&bytes, Options::IgnoreEndMagic.into())? {
        let message = message?;
        let topic = message.channel.topic.as_str();
        if !is_wanted(topic) {
            continue;
        }
        if !kinds.contains_key(topic) {
            let schema = message.channel.schema.as_ref().context("a channel without a schema")?;
            let kind = DescriptorPool::decode(&*schema.data)?.get_message_by_name(&schema.name);
            kinds.insert(topic.to_owned(), kind.context("a schema without its message")?);
        }
        take(topic, DynamicMessage::decode(kinds[topic].clone(), &*message.data)?);
    }
    Ok(())
}

/// What is in some copy, if no two copies contradict each other.
fn merged(copies: &[Copy]) -> Option<Copy> {
    let mut all = copies.first()?.clone();
    for Copy { always, sometimes } in copies {
        let agrees = |(name, value): (&String, &String)| all.sometimes.get(name).is_none_or(|other| other == value);
        if *always != all.always || !sometimes.iter().all(agrees) {
            return None;
        }
        all.sometimes.extend(sometimes.clone());
    }
    Some(all)
}

/// `may_lack`: the fields that ours need not have.
fn compare(
    what: &str,
    ours: &BTreeMap<Key, Vec<Copy>>,
    theirs: &BTreeMap<Key, Vec<Copy>>,
    may_lack: impl Fn(&Key, &str) -> bool,
    found: &mut Vec<String>,
) {
    let place = |(kitchen, environment, episode, step): &Key| format!("{kitchen}/{environment} {episode}:{step}");
    let some = |keys: &[&Key]| keys.iter().take(3).map(|key| place(key)).collect::<Vec<_>>().join(", ");
    let missing: Vec<_> = theirs.keys().filter(|key| !ours.contains_key(key)).collect();
    let besides: Vec<_> = ours.keys().filter(|key| !theirs.contains_key(key)).collect();
    let same = |key: &Key, ours: &[Copy], theirs: &[Copy]| {
        let (Some(mut ours), Some(theirs)) = (merged(ours), merged(theirs)) else { return false };
        for (name, value) in theirs.sometimes.iter().filter(|(name, _)| may_lack(key, name)) {
            ours.sometimes.entry(name.clone()).or_insert_with(|| value.clone());
        }
        ours == theirs
    };
    let other = |(key, copies): &(&Key, &Vec<Copy>)| theirs.get(key).is_some_and(|their| !same(key, copies, their));
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

    fn step(episode: u32, number: u32, hash: u8) -> (Key, Copy) {
        ((1, 0, episode, number), Copy { always: vec![hash], ..Copy::default() })
    }

    fn recording(steps: &[(Key, Copy)]) -> Recording {
        let mut recording = Recording::default();
        for (key, step) in steps {
            recording.steps.entry(*key).or_default().push(step.clone());
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
    fn a_missing_step_is_seen_wherever_it_was() {
        let course = [(0, 0), (0, 1), (1, 0), (2, 0), (2, 1)];
        let without = |left_out: usize| {
            let kept = course.iter().enumerate().filter(|(index, _)| *index != left_out);
            let steps: Vec<_> = kept.map(|(_, &(episode, number))| step(episode, number, 0)).collect();
            let closed = vec![((1, 0, 0, 0), (1, 1), 2), ((1, 0, 1, 0), (1, 1), 1)];
            let recording = Recording { closed, ..recording(&steps) };
            (recording.steps(), recording.holes().len())
        };
        assert_eq!(without(9), (5, 0));
        // The last one is missed by its count alone.
        assert_eq!([0, 1, 2, 3, 4].map(without), [(4, 1), (4, 1), (4, 1), (4, 1), (4, 0)]);
    }

    #[test]
    fn what_was_seen_must_be_in_one_copy() {
        let seen = |goal: &str| {
            let (key, step) = step(0, 0, 1);
            (key, Copy { sometimes: BTreeMap::from([("goal_m".to_owned(), goal.to_owned())]), ..step })
        };
        let reference = recording(&[seen("1")]);
        let once = recording(&[step(0, 0, 1), seen("1")]);
        assert!(once.differences(&reference).is_empty());
        assert_eq!(recording(&[step(0, 0, 1)]).differences(&reference).len(), 1);
        assert_eq!(recording(&[seen("2")]).differences(&reference).len(), 1);
        assert_eq!(recording(&[seen("2"), seen("1")]).differences(&reference).len(), 1);
    }

    #[test]
    fn an_end_lacks_only_what_is_of_steps_that_its_recorder_has_not_seen() {
        let key = (1, 0, 4, 0);
        let ended = |names: &[&str], learner_of_first: u32| {
            let sometimes = names.iter().map(|&name| (name.to_owned(), "1".to_owned())).collect();
            let copy = Copy { always: vec![], sometimes };
            Recording {
                ends: BTreeMap::from([(key, vec![copy])]),
                order: vec![((1, 0, 4, 0), (1, learner_of_first)), ((1, 0, 4, 1), (1, 2))],
                closed: vec![(key, (1, 2), 2)],
                ..Recording::default()
            }
        };
        let reference = ended(&["return_r", "picked_up", "success"], 2);
        assert!(ended(&["return_r", "picked_up", "success"], 2).differences(&reference).is_empty());
        assert!(ended(&["success"], 1).differences(&reference).is_empty());
        // One recorder has seen all of it; and what the last step says is never absent.
        for (names, learner) in [(&["success"][..], 2), (&["return_r", "success"], 2), (&["return_r", "picked_up"], 1)]
        {
            assert_eq!(ended(names, learner).differences(&reference).len(), 1, "{names:?}");
        }
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
