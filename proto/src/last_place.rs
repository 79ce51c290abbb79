//! Where an actor that simulates with the code of others was when it died: such code may end the process, or never
//! return. The actor writes the place down before every call of it.

use std::fmt;

/// A step of an environment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LastPlace {
    /// Its number over the whole run.
    pub environment: u32,
    pub episode: u32,
    /// Actions taken before it in the episode.
    pub step: u32,
}

impl LastPlace {
    /// As it lies in its file.
    pub fn to_bytes(self) -> [u8; 12] {
        let mut bytes = [0; 12];
        for (bytes, number) in bytes.chunks_exact_mut(4).zip([self.environment, self.episode, self.step]) {
            bytes.copy_from_slice(&number.to_le_bytes());
        }
        bytes
    }

    /// What lies in a file; none if it holds anything else.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let bytes: [u8; 12] = bytes.try_into().ok()?;
        let [environment, episode, step] =
            std::array::from_fn(|at| u32::from_le_bytes(std::array::from_fn(|byte| bytes[4 * at + byte])));
        Some(Self { environment, episode, step })
    }
}

impl fmt::Display for LastPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "environment {}, episode {}, step {}", self.environment, self.episode, self.step)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_read_as_it_was_written() {
        let place = LastPlace { environment: 12, episode: 700, step: 31 };
        assert_eq!(LastPlace::from_bytes(&place.to_bytes()), Some(place));
        assert_eq!(LastPlace::from_bytes(&place.to_bytes()[..11]), None);
        assert_eq!(place.to_string(), "environment 12, episode 700, step 31");
    }
}
