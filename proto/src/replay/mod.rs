//! Re-simulation of recorded episodes: requests from `orchestrator replay` on the standard input of `actor replay`, and
//! results on its standard output, one JSON object per line.

mod play;

pub use play::{Performance, PlayError, Player, Rules, Seen, play};

use crate::episode::EnvironmentId;
use crate::record::End;
use crate::task::{Composition, Field, Layout, Spec, SpecError};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// First line of the input.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ReplaySetup {
    /// The run's effective configuration, as TOML.
    pub config: String,
    /// The run folder, which the configuration's scenes are named relative to; none where it is not known.
    #[serde(default)]
    pub folder: Option<String>,
    /// How to draw the episodes; none = compare hashes only.
    pub images: Option<ReplayImages>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ReplayImages {
    pub folder: String,
    pub format: ImageFormat,
    /// Width and height of a still, or of each of a moving picture's two views, pixels.
    pub side: u32,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ImageFormat {
    /// Depth alone: a 16-bit PNG a frame, millimetres.
    Png,
    /// One animated PNG an episode, in colour: plays in any browser.
    Apng,
    /// One MP4 an episode, in colour.
    Mp4(Ffmpeg),
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Ffmpeg {
    pub program: String,
    /// Its H.264 encoder, e.g. `libx264`.
    pub encoder: String,
}

/// Every further line of the input: one recorded episode, possibly cut off at its end.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordedEpisode {
    pub environment: EnvironmentId,
    pub episode: u32,
    /// Hash of its first state, if the recording holds it.
    pub start_hash: Option<u64>,
    /// The actions from step 0, each as the bytes that it has in a record.
    pub actions: Vec<u8>,
    /// State hash after each action.
    pub hashes: Vec<u64>,
    /// Digests of what [`Compared`] names, for each action; or none.
    #[serde(default)]
    pub digests: Vec<u32>,
    /// The same of the episode's beginning, if the recording holds it; otherwise none.
    #[serde(default)]
    pub start: Vec<u32>,
}

/// What differs where the simulator's state does, and where the recording goes on after an episode's end.
pub const STATE: &str = "state";
pub const LENGTH: &str = "length";

/// What a replay compares of a step beside the simulator's state, by name: what the policy saw, what the action did, the
/// task's rewards, and how the step ended the episode.
#[derive(Debug, Clone)]
pub struct Compared {
    /// Channels but images, and whether they are of the action.
    channels: Vec<(String, Field, bool)>,
    /// The task's rewards, but those that training weighs as it goes.
    rewards: Vec<(String, Composition)>,
}

impl Compared {
    pub fn of(spec: &Spec, weights: &BTreeMap<String, f32>) -> Result<Self, SpecError> {
        let channels = spec.channels.iter().zip(&spec.layout().fields).filter(|(channel, _)| !channel.is_bulk());
        let rewards = spec.plain_rewards();
        let rewards = rewards.map(|name| Ok((name.to_owned(), spec.composition(name, &[], weights)?)));
        let channels = channels.map(|(channel, &field)| (channel.name.clone(), field, channel.is_of_action()));
        Ok(Self { channels: channels.collect(), rewards: rewards.collect::<Result<_, SpecError>>()? })
    }

    /// What each digest is of.
    pub fn names(&self) -> impl Iterator<Item = String> {
        let channels = self.channels.iter().map(|(name, ..)| name.clone());
        let rewards = self.rewards.iter().map(|(name, _)| format!("reward_{name}"));
        channels.chain(rewards).chain(["end".to_owned()])
    }

    pub fn count(&self) -> usize {
        self.channels.len() + self.rewards.len() + 1
    }

    /// Whether a digest, by its place, is of what was seen.
    pub fn is_seen(&self, at: usize) -> bool {
        self.channels.get(at).is_some_and(|(_, _, of_action)| !of_action)
    }

    pub fn start_count(&self) -> usize {
        self.channels.len()
    }

    pub fn rewards(&self) -> impl ExactSizeIterator<Item = &str> {
        self.rewards.iter().map(|(name, _)| &**name)
    }

    pub fn reward(&self, layout: &Layout, record: &[u8], rewards: &mut Vec<f32>) {
        rewards.clear();
        let composed = self.rewards.iter().map(|(_, reward)| reward.of(|index| layout.part(record, index), 0.0));
        rewards.extend(composed);
    }

    /// Appends the digests of a step. `seen`: the record from which its action was chosen, if that is known; `acted`: that
    /// of what the action did.
    pub fn step(&self, seen: Option<&[u8]>, acted: &[u8], rewards: &[f32], end: Option<End>, out: &mut Vec<u32>) {
        out.extend(self.channels.iter().map(|(_, field, of_action)| {
            let record = if *of_action { Some(acted) } else { seen };
            record.map_or(0, |record| digest(field.bits(record)))
        }));
        out.extend(rewards.iter().map(|reward| digest([reward.to_bits().into()])));
        out.push(digest([end.map_or(0, |end| 1 + u64::from(end == End::Truncated))]));
    }

    /// Digests of an episode's beginning: of what is seen in its first record.
    pub fn start(&self, record: &[u8]) -> Vec<u32> {
        let seen =
            |(_, field, of_action): &(String, Field, bool)| if *of_action { 0 } else { digest(field.bits(record)) };
        self.channels.iter().map(seen).collect()
    }
}

/// FNV-1a over the numbers' bytes. Never 0, which stands for what was not recorded.
fn digest(numbers: impl IntoIterator<Item = u64>) -> u32 {
    let bytes = numbers.into_iter().flat_map(u64::to_le_bytes);
    bytes.fold(0x811C_9DC5_u32, |digest, byte| (digest ^ u32::from(byte)).wrapping_mul(0x0100_0193)).max(1)
}

/// A line of the output.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum ReplayLine {
    Verdict(Box<ReplayVerdict>),
    /// So many more moments of an episode are drawn.
    Drawn {
        drawn: u64,
    },
}

/// The verdict on one episode. They come in input order.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ReplayVerdict {
    pub environment: EnvironmentId,
    pub episode: u32,
    /// States compared, the first one included.
    pub compared: u64,
    pub first_difference: Option<Difference>,
    pub images: u64,
    /// Name of its film's file, if it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub film: Option<String>,
}

#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Difference {
    /// Actions taken until then; for what was seen, before the action that was chosen from it.
    pub step: u64,
    /// What differs: [`STATE`], [`LENGTH`], or one of [`Compared::names`].
    pub what: String,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whatever byte of whatever channel, and whatever reward or end: one digest changes, and it is named.
    #[test]
    fn every_number_of_a_step_is_in_the_digest_of_its_name() {
        for spec in Spec::built_in() {
            let compared = Compared::of(spec, &BTreeMap::new()).unwrap();
            let names: Vec<String> = compared.names().collect();
            let record = vec![0; spec.layout().small_bytes];
            let rewards = vec![0.5; compared.rewards().len()];
            let digests = |seen: &[u8], acted: &[u8], rewards: &[f32], end| {
                let mut out = vec![];
                compared.step(Some(seen), acted, rewards, end, &mut out);
                out
            };
            let base = digests(&record, &record, &rewards, None);
            assert_eq!((base.len(), base.contains(&0)), (compared.count(), false));
            let differing = |other: &[u32]| {
                let pairs = names.iter().zip(base.iter().zip(other));
                pairs.filter(|(_, (one, other))| one != other).map(|(name, _)| name.clone()).collect::<Vec<_>>()
            };
            for (channel, field) in spec.channels.iter().zip(&spec.layout().fields) {
                for byte in field.range().filter(|_| !channel.is_bulk()) {
                    let mut altered = record.clone();
                    altered[byte] ^= 0x80;
                    let seen = if channel.is_of_action() { &record } else { &altered };
                    let acted = if channel.is_of_action() { &altered } else { &record };
                    assert_eq!(differing(&digests(seen, acted, &rewards, None)), [&*channel.name]);
                    let is_of_start = compared.start(&altered) != compared.start(&record);
                    assert_eq!(is_of_start, !channel.is_of_action(), "{}", channel.name);
                }
            }
            for (at, name) in compared.rewards().enumerate() {
                let mut altered = rewards.clone();
                altered[at] = -0.5;
                assert_eq!(differing(&digests(&record, &record, &altered, None)), [format!("reward_{name}")]);
            }
            for end in [End::Terminated, End::Truncated] {
                assert_eq!(differing(&digests(&record, &record, &rewards, Some(end))), ["end"]);
            }
            let mut unknown = vec![];
            compared.step(None, &record, &rewards, None, &mut unknown);
            let zeros = unknown.iter().filter(|&&digest| digest == 0).count();
            let seen = spec.channels.iter().filter(|channel| !channel.is_bulk() && !channel.is_of_action()).count();
            assert_eq!(zeros, seen, "what was not recorded is not compared");
        }
    }
}
