//! What an actor notes of a user's environment: the step of the call that it is in, and whether memory grows without end.

use proto::actor_notes::{Growth, LastPlace, WORDS};
use std::io::{Error, ErrorKind, Result};
use std::path::Path;
use wire::SharedWords;

/// Less is no matter.
const LEAST_BYTES: u64 = 64 << 20;
/// Episodes until memory is looked at first.
const FIRST_EPISODES: u64 = 8;

/// The file of one actor, mapped: a note is two stores.
pub(super) struct Notes {
    words: SharedWords,
    memory: Memory,
    is_warned: bool,
}

impl Notes {
    /// An empty file in place of an earlier actor's.
    pub fn create(path: &Path) -> Result<Self> {
        match std::fs::remove_file(path) {
            Err(error) if error.kind() != ErrorKind::NotFound => return Err(error),
            _ => SharedWords::create(path, WORDS)?,
        }
        Ok(Self { words: SharedWords::open(path, WORDS, true)?, memory: Memory::default(), is_warned: false })
    }

    /// Others' code is called here, and may not return.
    pub fn enter(&self, place: LastPlace) {
        for (index, word) in place.to_words().into_iter().enumerate() {
            self.words.store(index, word);
        }
    }

    /// An episode has ended. Growth is a warning once, and stays in the file as long as it goes on.
    pub fn ended(&mut self) {
        if !self.memory.is_due() {
            return;
        }
        let Ok(bytes) = own_bytes() else { return };
        let growth = self.memory.grown(bytes);
        for (index, word) in (2..).zip(Growth::to_words(growth)) {
            self.words.store(index, word);
        }
        if let (Some(growth), false) = (growth, self.is_warned) {
            self.is_warned = true;
            tracing::warn!("{growth}");
        }
    }
}

/// The memory of a process whenever its episodes have doubled. Of a leak each doubling takes about twice as much as the one
/// before; what warms up or fills a cache takes less and less, and what is loaded once does not go on.
#[derive(Debug, Default)]
struct Memory {
    episodes: u64,
    /// After an eighth, a quarter, half of the episodes, and now.
    bytes: [Option<u64>; 4],
}

impl Memory {
    /// Counts an episode; whether memory is looked at after it.
    fn is_due(&mut self) -> bool {
        self.episodes += 1;
        self.episodes >= FIRST_EPISODES && self.episodes.is_power_of_two()
    }

    /// It has so many bytes now. The growth since half the episodes, if memory has doubled since an eighth of them, as
    /// steadily all the time.
    fn grown(&mut self, bytes: u64) -> Option<Growth> {
        self.bytes.rotate_left(1);
        self.bytes[3] = Some(bytes);
        let [Some(eighth), Some(quarter), Some(half), Some(now)] = self.bytes else { return None };
        let [first, second, last] =
            [(eighth, quarter), (quarter, half), (half, now)].map(|(before, after)| after.saturating_sub(before));
        let doubles = |before: u64, after: u64| (3 * before..=6 * before).contains(&(2 * after));
        let leaks = last >= LEAST_BYTES && now >= 2 * eighth && doubles(first, second) && doubles(second, last);
        leaks.then_some(Growth { bytes: last, episodes: self.episodes / 2 })
    }
}

/// Memory of this process that is no file's and shared with nobody.
fn own_bytes() -> Result<u64> {
    let text = std::fs::read_to_string("/proc/self/status")?;
    let kib =
        text.lines().find_map(|line| line.strip_prefix("RssAnon:")?.trim().strip_suffix(" kB")?.parse::<u64>().ok());
    kib.map(|kib| kib << 10).ok_or_else(|| Error::from(ErrorKind::InvalidData))
}

#[cfg(test)]
mod tests {
    use super::*;

    const MIB: f64 = (1 << 20) as f64;

    /// What is found in a process that has so many MiB after its episodes.
    fn found(mib: impl Fn(f64) -> f64) -> Vec<Growth> {
        let mut memory = Memory::default();
        let due = (0..1 << 20).filter_map(|_| {
            let due = memory.is_due();
            due.then(|| memory.grown((mib(memory.episodes as f64) * MIB) as u64)).flatten()
        });
        due.collect()
    }

    #[test]
    fn steady_growth_is_found_and_no_other() {
        let noise = |episodes: f64| 20.0 * (episodes * 0.7).sin();
        let leaks = [18, 19].map(|power| Growth { bytes: 1 << (power + 10), episodes: 1 << power });
        assert_eq!(found(|episodes| 200.0 + episodes / 1024.0), leaks);
        assert!(!found(|episodes| 200.0 + 20.0 * episodes.ln() + episodes / 1024.0 + noise(episodes)).is_empty());
        assert_eq!(found(|episodes| 200.0 + noise(episodes)), []);
        assert_eq!(found(|episodes| 200.0 + 80.0 * episodes.ln()), [], "an allocator that warms up");
        assert_eq!(found(|episodes| 200.0 + 40.0 * episodes.sqrt()), [], "new things become rare");
        assert_eq!(found(|episodes| 200.0 + 400.0 * (1.0 - (-episodes / 3e4).exp())), [], "a cache that fills up");
        assert_eq!(found(|episodes| 200.0 + 2000.0 * f64::from(episodes > 2e5)), [], "what is loaded once");
        assert_eq!(found(|episodes| 200.0 + 700.0 * (episodes / 3.1).fract()), [], "what is let go now and then");
        assert_eq!(found(|episodes| 200.0 + episodes / 32_768.0), [], "too little to matter");
    }

    #[test]
    fn this_process_has_memory() {
        assert!(own_bytes().expect("Linux says it") > 1 << 16);
    }
}
