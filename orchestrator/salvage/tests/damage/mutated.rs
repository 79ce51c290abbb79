//! Recordings that were altered: reading ends without a panic, and what it says of its loss is true.

use mcap::records::{MessageHeader, Metadata, Record};
use mcap::{Attachment, WriteOptions};
use proptest::prelude::*;
use salvage::Account;
use std::borrow::Cow;
use std::collections::{BTreeMap, HashSet};
use std::io::Cursor;
use std::sync::LazyLock;
use std::time::{Duration, Instant};

const MESSAGES: u64 = 600;

static WHOLE: LazyLock<Vec<u8>> = LazyLock::new(recording);

struct Read {
    account: Account,
    /// Every message: channel, sequence, log time, content.
    messages: Vec<(u16, u32, u64, Vec<u8>)>,
    /// Every other record that is kept, in words; without what a repair adds.
    others: Vec<String>,
}

fn read(file: &[u8]) -> Read {
    let (mut messages, mut others) = (Vec::new(), Vec::new());
    let account = salvage::read(&file, |record| {
        match record {
            Record::Message { header, data } => {
                messages.push((header.channel_id, header.sequence, header.log_time, data.into_owned()));
            }
            Record::Metadata(Metadata { name, .. }) if name == salvage::REPAIR_METADATA => {}
            Record::Schema { .. } | Record::Channel(_) => {}
            record => others.push(format!("{record:?}")),
        }
        Ok::<_, std::convert::Infallible>(())
    });
    Read { account: account.unwrap(), messages, others }
}

fn repaired(file: &[u8]) -> Vec<u8> {
    let mut out = Cursor::new(Vec::new());
    salvage::rewrite(&file, WriteOptions::new(), &mut out).unwrap();
    out.into_inner()
}

/// A whole recording: three channels, an attachment, metadata, private records in and beside chunks, all checksums.
fn recording() -> Vec<u8> {
    let options = WriteOptions::new().chunk_size(Some(6000)).profile("ours").library("maker");
    let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
    let metadata = BTreeMap::from([("by".to_owned(), "the maker".to_owned())]);
    writer.write_metadata(&Metadata { name: "notes".to_owned(), metadata }).unwrap();
    let attachment = Attachment {
        log_time: 1,
        create_time: 2,
        name: "config.toml".to_owned(),
        media_type: "application/toml".to_owned(),
        data: Cow::Borrowed(b"seed = 7\nsteps = 12\n"),
    };
    writer.attach(&attachment).unwrap();
    let channels = [("/step", "Step"), ("/log", "Log"), ("/bare", "")].map(|(topic, name)| {
        let schema = match name {
            "" => 0,
            name => writer.add_schema(name, "protobuf", name.repeat(40).as_bytes()).unwrap(),
        };
        writer.add_channel(schema, topic, "protobuf", &BTreeMap::new()).unwrap()
    });
    let mut noise = 1u32;
    for number in 0..MESSAGES {
        let channel_id = channels[number as usize % 7 % 3];
        let time = 1_790_000_000_000_000_000 + number * 1_000_000;
        let header = MessageHeader { channel_id, sequence: number as u32, log_time: time, publish_time: time };
        let mut byte = || {
            noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            // Half of it can be packed.
            if noise >> 31 == 0 { 0 } else { (noise >> 16) as u8 }
        };
        let data: Vec<u8> = (0..40 + number % 23).map(|_| byte()).collect();
        writer.write_to_known_channel(&header, &data).unwrap();
        if number == 200 {
            writer.write_private_record(0x90, b"between chunks", Default::default()).unwrap();
            let in_chunk = mcap::write::PrivateRecordOptions::IncludeInChunks.into();
            writer.write_private_record(0x91, b"in a chunk", in_chunk).unwrap();
        }
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

/// Kind and place of every record of a whole file, heads included.
fn records(file: &[u8]) -> Vec<(u8, std::ops::Range<usize>)> {
    let mut records = Vec::new();
    let mut at = mcap::MAGIC.len();
    while at + mcap::MAGIC.len() < file.len() {
        let end = at + 9 + u64::from_le_bytes(file[at + 1..at + 9].try_into().unwrap()) as usize;
        records.push((file[at], at..end));
        at = end;
    }
    records
}

fn altered(at: usize) -> Read {
    let mut file = WHOLE.clone();
    file[at] ^= 8;
    let damaged = read(&file);
    let whole = read(&repaired(&file));
    assert!(whole.account.is_whole(), "{:#?}", whole.account);
    assert_eq!((whole.messages, whole.others), (damaged.messages.clone(), damaged.others.clone()));
    assert_eq!(whole.account.repaired_with_loss.is_some(), !damaged.account.is_lossless());
    damaged
}

#[test]
fn a_chunk_that_was_altered_is_left_out_and_its_messages_are_counted() {
    let chunks: Vec<_> =
        records(&WHOLE).into_iter().filter(|(opcode, _)| *opcode == mcap::records::op::CHUNK).collect();
    let damaged = altered(chunks[1].1.start + 150);
    let read = damaged.account.messages;
    assert!(read > MESSAGES / 2 && read < MESSAGES, "the other chunks are read: {:#?}", damaged.account);
    assert_eq!(damaged.account.outcome(), format!("{} messages lost", MESSAGES - read));
    assert!(damaged.account.lines()[0].contains(&format!("at byte {}: ", chunks[1].1.start)));
    // The first one has the channels of all.
    assert_eq!(altered(chunks[0].1.start + 150).account.outcome(), "600 messages lost");
}

#[test]
fn an_attachment_that_was_altered_is_left_out() {
    let place = WHOLE.windows(8).position(|eight| eight == b"seed = 7").unwrap();
    let damaged = altered(place);
    assert_eq!((damaged.account.messages, damaged.account.is_lossless()), (MESSAGES, false));
    assert!(!damaged.others.iter().any(|record| record.contains("config.toml")));
}

#[test]
fn a_file_that_was_cut_off_is_read_up_to_there() {
    let data_end = records(&WHOLE).into_iter().find(|(opcode, _)| *opcode == mcap::records::op::DATA_END).unwrap().1;
    for (length, outcome) in [
        (WHOLE.len() - 1, "nothing was lost"),
        (data_end.end, "nothing was lost"),
        (data_end.start, "what came after its end is lost"),
        (WHOLE.len() / 2, "what came after its end is lost"),
    ] {
        let cut = read(&WHOLE[..length]);
        assert_eq!((cut.account.outcome().as_str(), cut.account.cut, cut.account.is_whole()), (outcome, true, false));
        assert_eq!(cut.messages, read(&WHOLE).messages[..cut.messages.len()]);
        assert_eq!(cut.messages.len() as u64 == MESSAGES, length >= data_end.start);
        assert!(cut.account.lines()[0].contains("the file ends here, before its end mark"));
    }
}

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
    fn any_bytes_are_read(
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
        let got = read(&file);
        prop_assert_eq!(got.messages.len() as u64, got.account.messages);
        prop_assert!(!got.account.is_whole() || file.ends_with(mcap::MAGIC));
    }
}
