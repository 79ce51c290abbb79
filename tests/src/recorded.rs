//! The steps that a run's recordings hold, read without any code of the system.

use crate::Run;
use prost::Message;
use prost_reflect::{DescriptorPool, DynamicMessage, MessageDescriptor};
use std::collections::BTreeMap;

/// What is needed of a `stillroom.Step`.
// Names of the recorded message.
#[allow(clippy::struct_field_names)]
struct Step {
    kitchen: u32,
    environment: u32,
    episode: u32,
    step: u32,
    ended: bool,
}

impl Step {
    fn of(message: &DynamicMessage) -> Self {
        let value = |name: &str| message.get_field_by_name(name).expect("a field of steps").into_owned();
        let number = |name: &str| value(name).as_u32().expect("a number");
        let is = |name: &str| value(name).as_bool().expect("yes or no");
        Self {
            kitchen: number("kitchen"),
            environment: number("environment"),
            episode: number("episode"),
            step: number("step"),
            ended: is("terminated") || is("truncated"),
        }
    }
}

/// What is needed of a `foxglove.RawImage`.
#[derive(Clone, PartialEq, Message)]
struct Image {
    #[prost(bytes, tag = "6")]
    data: Vec<u8>,
}

/// The recorded depth frames of a run, by topic, in the order in which they were written.
pub fn recorded_depth(run: &Run) -> BTreeMap<String, Vec<Vec<u8>>> {
    let mut frames: BTreeMap<String, Vec<Vec<u8>>> = BTreeMap::new();
    for path in run.recordings() {
        let bytes = std::fs::read(&path).expect("a readable recording");
        for message in mcap::MessageStream::new(&bytes).expect("an MCAP file") {
            let message = message.expect("a whole message");
            let topic = &message.channel.topic;
            if topic.starts_with("/depth/") && topic.ends_with("/image") {
                let image = Image::decode(&*message.data).expect("an image");
                frames.entry(topic.clone()).or_default().push(image.data);
            }
        }
    }
    frames
}

/// The recorded steps of a run, each counted once however often it was recorded.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct RecordedSteps {
    /// By (kitchen, environment): by (episode, step): whether it ended the episode.
    environments: BTreeMap<(u32, u32), BTreeMap<(u32, u32), bool>>,
    pub messages: u64,
}

impl RecordedSteps {
    /// Of all recordings of a run.
    pub fn of(run: &Run) -> Self {
        let mut recorded = Self::default();
        for path in run.recordings() {
            let bytes = std::fs::read(&path).expect("a readable recording");
            let mut kind: Option<MessageDescriptor> = None;
            for message in mcap::MessageStream::new(&bytes).expect("an MCAP file") {
                let message = message.expect("a whole message");
                if message.channel.topic == "/step" {
                    let schema = message.channel.schema.as_ref().expect("a schema");
                    let kind = kind.get_or_insert_with(|| {
                        let pool = DescriptorPool::decode(&*schema.data).expect("a descriptor");
                        pool.get_message_by_name(&schema.name).expect("a step")
                    });
                    let step = DynamicMessage::decode(kind.clone(), &*message.data).expect("a step");
                    recorded.add(&Step::of(&step));
                }
            }
        }
        recorded
    }

    fn add(&mut self, step: &Step) {
        self.messages += 1;
        let environment = self.environments.entry((step.kitchen, step.environment)).or_default();
        environment.insert((step.episode, step.step), step.ended);
    }

    pub fn count(&self) -> u64 {
        self.environments.values().map(|steps| steps.len() as u64).sum()
    }

    /// Where an environment's course breaks off and goes on later: each step follows the one before it in its episode,
    /// or begins the episode after one that ended.
    pub fn holes(&self) -> Vec<String> {
        let mut holes = vec![];
        for (environment, steps) in &self.environments {
            let mut expected = (0, 0);
            for (&(episode, step), &ended) in steps {
                if (episode, step) != expected {
                    holes.push(format!("{environment:?}: {expected:?} is missing before {:?}", (episode, step)));
                }
                expected = if ended { (episode + 1, 0) } else { (episode, step + 1) };
            }
        }
        holes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_step_is_seen_wherever_it_was() {
        let step = |episode, step, ended| Step { kitchen: 3, environment: 1, episode, step, ended };
        let course = [step(0, 0, false), step(0, 1, true), step(1, 0, true), step(2, 0, false), step(2, 1, false)];
        let without = |left_out: Option<usize>| {
            let mut recorded = RecordedSteps::default();
            let kept = course.iter().enumerate().filter(|(index, _)| Some(*index) != left_out);
            kept.for_each(|(_, step)| recorded.add(step));
            (recorded.count(), recorded.holes().len())
        };
        assert_eq!(without(None), (5, 0));
        // The last one is missed by its count alone.
        assert_eq!((0..5).map(|index| without(Some(index))).collect::<Vec<_>>()[..4], [(4, 1); 4]);
        assert_eq!(without(Some(4)), (4, 0));
    }
}
