//! The notes of an actor that runs a user's environment, because that may end the process, hang or leak. The file is a few
//! words, which the actor maps.

use crate::run_folder::RunFolder;
use std::fmt;

const MIB: f64 = (1 << 20) as f64;

pub const WORDS: usize = 4;

/// A step of an environment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LastPlace {
    /// Its number over the whole run.
    pub environment: u32,
    pub episode: u32,
    /// Actions taken before it in the episode.
    pub step: u32,
}

/// Memory that grew by as much in each episode as in those before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Growth {
    pub bytes: u64,
    /// Episodes in which it grew by that.
    pub episodes: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Noted {
    /// Where the actor was last: it is written down before every call of others' code.
    pub place: LastPlace,
    /// How its memory grows, if it grows without an end in sight.
    pub growth: Option<Growth>,
}

impl LastPlace {
    /// Words 0 and 1 of the file.
    pub fn to_words(self) -> [u64; 2] {
        [u64::from(self.environment) | u64::from(self.episode) << 32, self.step.into()]
    }
}

impl Growth {
    /// Words 2 and 3 of the file.
    pub fn to_words(growth: Option<Self>) -> [u64; 2] {
        growth.map_or([0; 2], |growth| [growth.bytes, growth.episodes])
    }
}

impl Noted {
    /// Those of an actor; none if there are none, or the file holds anything else.
    pub fn read(folder: &RunFolder, actor: u32) -> Option<Self> {
        Self::from_bytes(&folder.read(&folder.actor_notes(actor), (WORDS * size_of::<u64>()) as u64).ok()?)
    }

    fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (words, []) = bytes.as_chunks() else { return None };
        let words: [[u8; 8]; WORDS] = words.try_into().ok()?;
        let [place, step, bytes, episodes] = words.map(u64::from_ne_bytes);
        let place = LastPlace { environment: place as u32, episode: (place >> 32) as u32, step: step as u32 };
        Some(Self { place, growth: (episodes > 0).then_some(Growth { bytes, episodes }) })
    }
}

impl fmt::Display for LastPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "environment {}, episode {}, step {}", self.environment, self.episode, self.step)
    }
}

impl fmt::Display for Growth {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { bytes, episodes } = self;
        let mib = *bytes as f64 / MIB;
        write!(
            f,
            "its memory grew by {mib:.0} MiB in its last {episodes} episodes, and as fast before: an environment leaks"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_read_as_it_was_written() {
        let place = LastPlace { environment: 12, episode: 700, step: 31 };
        let growth = Growth { bytes: 96 << 20, episodes: 512 };
        for growth in [None, Some(growth)] {
            let words = [place.to_words(), Growth::to_words(growth)];
            let bytes: Vec<u8> = words.concat().into_iter().flat_map(u64::to_ne_bytes).collect();
            assert_eq!(Noted::from_bytes(&bytes), Some(Noted { place, growth }));
            assert_eq!(Noted::from_bytes(&bytes[..31]), None);
        }
        assert_eq!(place.to_string(), "environment 12, episode 700, step 31");
        assert!(growth.to_string().contains("grew by 96 MiB in its last 512 episodes, "));
    }
}
