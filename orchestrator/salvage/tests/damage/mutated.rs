//! Recordings that were altered at random places: reading ends without a panic, within its limits, and what it says of
//! its loss is true.

use crate::maker::{MESSAGES, read, read_within, recording, repaired};
use proptest::prelude::*;
use salvage::Limits;
use std::collections::HashSet;
use std::sync::LazyLock;
use std::time::{Duration, Instant};

static WHOLE: LazyLock<Vec<u8>> = LazyLock::new(|| recording("zstd"));

/// One way to damage a file; places are shares of its length.
#[derive(Debug, Clone)]
enum Damage {
    Flip(f64, u8),
    Write(f64, Vec<u8>),
    Insert(f64, Vec<u8>),
    Remove(f64, usize),
    Repeat(f64, usize),
    Cut(f64),
}

impl Damage {
    fn apply(&self, file: &mut Vec<u8>) {
        let place = |share: f64| (share * file.len() as f64) as usize;
        let until = |at: usize, length: usize| (at + length).min(file.len());
        match self {
            Self::Flip(share, bit) => {
                let at = place(*share);
                if let Some(byte) = file.get_mut(at) {
                    *byte ^= 1 << bit;
                }
            }
            Self::Write(share, bytes) => {
                let at = place(*share);
                let end = until(at, bytes.len());
                file[at..end].copy_from_slice(&bytes[..end - at]);
            }
            Self::Insert(share, bytes) => {
                let at = place(*share);
                file.splice(at..at, bytes.iter().copied());
            }
            Self::Remove(share, length) => {
                let at = place(*share);
                file.drain(at..until(at, *length));
            }
            Self::Repeat(share, length) => {
                let at = place(*share);
                let again = file[at..until(at, *length)].to_vec();
                file.splice(at..at, again);
            }
            Self::Cut(share) => file.truncate(place(*share)),
        }
    }
}

fn damage() -> impl Strategy<Value = Damage> {
    let bytes = || {
        prop_oneof![
            prop::collection::vec(any::<u8>(), 1..40),
            (1usize..600).prop_map(|length| vec![0; length]),
            (1usize..40).prop_map(|length| vec![0xff; length]),
        ]
    };
    let share = || 0.0..1.0f64;
    prop_oneof![
        4 => (share(), 0u8..8).prop_map(|(share, bit)| Damage::Flip(share, bit)),
        2 => (share(), bytes()).prop_map(|(share, bytes)| Damage::Write(share, bytes)),
        1 => (share(), bytes()).prop_map(|(share, bytes)| Damage::Insert(share, bytes)),
        1 => (share(), 1usize..3000).prop_map(|(share, length)| Damage::Remove(share, length)),
        1 => (share(), 1usize..3000).prop_map(|(share, length)| Damage::Repeat(share, length)),
        1 => share().prop_map(Damage::Cut),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 250, ..ProptestConfig::default() })]

    /// Whatever one damage does: a file that is called whole is the old one's content, one that is said to have lost
    /// nothing has every message, and the counts add up.
    #[test]
    fn the_account_of_one_damage_is_true(damage in damage()) {
        let mut file = WHOLE.clone();
        damage.apply(&mut file);
        if file.len() < 8 || file[..8] != WHOLE[..8] {
            return Ok(());
        }
        let original = read(&WHOLE);
        let got = read(&file);
        let known: HashSet<_> = original.messages.iter().collect();
        let sound = got.messages.iter().filter(|message| known.contains(message)).collect::<HashSet<_>>();
        if got.account.is_whole() {
            prop_assert_eq!(&got.messages, &original.messages);
            prop_assert_eq!(&got.others, &original.others);
        }
        if got.account.is_lossless() {
            prop_assert_eq!(sound.len() as u64, MESSAGES, "{:#?}", got.account);
        } else {
            prop_assert!(!got.account.lines().is_empty());
        }
        if !got.account.lost_unknown {
            prop_assert!(got.account.messages + got.account.lost >= MESSAGES, "{:#?}", got.account);
        }
        prop_assert_eq!(got.account.doubtful, got.doubtful);
    }

    /// Whatever many damages do: what is read can be written as a whole file, and is all in it.
    #[test]
    fn what_is_read_of_many_damages_makes_a_whole_file(damages in prop::collection::vec(damage(), 1..12)) {
        let mut file = WHOLE.clone();
        for damage in &damages {
            damage.apply(&mut file);
        }
        if file.len() < 8 || file[..8] != WHOLE[..8] {
            return Ok(());
        }
        let started = Instant::now();
        let got = read(&file);
        prop_assert!(started.elapsed() < Duration::from_secs(5));
        let whole = read(&repaired(&file));
        prop_assert!(whole.account.is_whole(), "{:#?}", whole.account);
        prop_assert_eq!(whole.messages, got.messages);
    }

    /// Bytes that never were a recording, behind magic bytes.
    #[test]
    fn any_bytes_are_read_within_the_limits(
        parts in prop::collection::vec((1u8..=15, prop::collection::vec(any::<u8>(), 0..80), any::<bool>()), 0..60),
    ) {
        let mut file = mcap::MAGIC.to_vec();
        for (opcode, body, framed) in parts {
            if framed {
                file.push(opcode);
                file.extend((body.len() as u64).to_le_bytes());
            }
            file.extend(body);
        }
        let limits = Limits { record_bytes: 4096, chunk_bytes: 4096, total_bytes: 65536, total_factor: 1 };
        let got = read_within(&file, &limits);
        prop_assert_eq!(got.messages.len() as u64, got.account.messages);
        prop_assert!(!got.account.is_whole() || file.ends_with(mcap::MAGIC));
    }
}
