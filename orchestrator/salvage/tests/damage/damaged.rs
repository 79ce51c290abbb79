//! Damaged files, and what is read of each. Each kind of damage was met in a recording, or made a reader panic, hang or
//! drop what it could have read.

use crate::maker::{MESSAGES, Raw, Read, read, recording, records, repaired};
use mcap::records::op;
use salvage::{Account, Cost, Limits};

const CHUNK_HEAD: &str = "the head of a chunk was altered";
const CHUNK_SUM: &str = "a chunk's checksum does not agree with its content";
const CUT: &str = "the file ends here, before its end mark";
const DATA_SUM: &str = "the checksum over all data does not agree: something was altered";
const UNREADABLE: &str = "no record can be recognised";

/// What is read and what that cost: messages, doubtful ones, lost ones; the one finding.
fn found(read: &Read) -> (u64, u64, u64, &str) {
    let Account { messages, doubtful, lost, ref findings, .. } = read.account;
    assert_eq!(findings.len(), 1, "{findings:#?}");
    (messages, doubtful, lost, &findings[0].problem)
}

/// Damage that costs nothing: every message is read, the file is not called complete, and repaired it is whole.
fn costs_nothing(file: &[u8], problem: &str) {
    let damaged = read(file);
    assert_eq!(found(&damaged), (MESSAGES, 0, 0, problem));
    assert!(damaged.account.is_lossless() && !damaged.account.is_whole());
    assert_eq!(damaged.messages, read(&recording("zstd")).messages);
    let whole = read(&repaired(file));
    assert!(whole.account.is_whole(), "{:#?}", whole.account);
    assert_eq!(whole.messages, damaged.messages);
    assert_eq!(whole.others, damaged.others, "attachments, metadata, private records, profile and library");
}

fn altered(offset: u64, byte: impl Fn(u8) -> u8) -> Vec<u8> {
    let mut file = recording("zstd");
    let place = &mut file[offset as usize];
    *place = byte(*place);
    file
}

/// Places of the records of this kind.
fn places(opcode: u8) -> Vec<u64> {
    records(&recording("zstd")).into_iter().filter(|record| record.0 == opcode).map(|record| record.1).collect()
}

#[test]
fn whole_files_are_whole_in_every_compression() {
    for compression in ["", "zstd", "lz4"] {
        let read = read(&recording(compression));
        assert!(read.account.is_whole() && read.account.is_lossless(), "{compression}: {:#?}", read.account);
        assert_eq!(read.account.messages, MESSAGES, "{compression}");
        assert_eq!(read.doubtful, 0);
    }
}

#[test]
fn an_unknown_compression_is_refused_and_the_rest_read() {
    let read = read(&recording("brotli"));
    assert_eq!(read.account.messages, 0);
    assert_eq!(read.account.lost, MESSAGES);
    assert!(read.account.findings[0].to_string().contains("`brotli` is not known"), "{:?}", read.account.findings);
}

#[test]
fn a_chunk_whose_content_was_altered_keeps_its_messages_as_doubtful_ones() {
    // In the middle of the packed bytes of the first chunk, which holds the schemas and channels of all.
    let chunks = places(op::CHUNK);
    let file = altered(chunks[0] + 150, |byte| byte ^ 8);
    let damaged = read(&file);
    assert_eq!(damaged.account.messages + damaged.account.lost, MESSAGES, "{:#?}", damaged.account);
    assert!(damaged.account.messages >= MESSAGES * 2 / 3, "the other chunks are read: {:#?}", damaged.account);
    assert!(!damaged.account.is_lossless());
    let finding = &damaged.account.findings[0];
    assert_eq!(finding.offset, chunks[0]);
    assert_eq!(finding.times_ns.map(|times| times.0), Some(crate::maker::time_ns(0)));
    let whole = read(&repaired(&file));
    assert!(whole.account.is_whole());
    assert_eq!(whole.account.messages, damaged.account.messages);
    assert!(whole.account.repaired_with_loss.is_some(), "the repaired file says what was lost");
}

#[test]
fn a_checksum_that_does_not_agree_leaves_doubt_but_no_loss() {
    // Checksum in the header of the second chunk: opcode, length, two times, size.
    let damaged = read(&altered(places(op::CHUNK)[1] + 9 + 24, |byte| byte ^ 1));
    let (messages, doubtful, lost, problem) = found(&damaged);
    assert_eq!((messages, lost, problem), (MESSAGES, 0, CHUNK_SUM));
    assert_eq!(doubtful, damaged.doubtful);
    assert!(doubtful > 0 && doubtful < MESSAGES);
    assert_eq!(damaged.account.findings[0].cost, Cost::Doubt(doubtful));
}

#[test]
fn a_chunk_that_lost_its_kind_or_length_is_found_by_its_checksum() {
    let chunks = places(op::CHUNK);
    for chunk in [chunks[0], chunks[1], *chunks.last().unwrap()] {
        for flip in [0x80, 0x40, 1, 2, 3, 4] {
            costs_nothing(&altered(chunk, |byte| byte ^ flip), CHUNK_HEAD);
        }
        costs_nothing(&altered(chunk + 1, |byte| byte ^ 1), CHUNK_HEAD);
        costs_nothing(&altered(chunk + 8, |byte| byte ^ 0x80), CHUNK_HEAD);
    }
}

#[test]
fn indexes_are_not_needed() {
    let index = places(op::MESSAGE_INDEX)[1];
    costs_nothing(&altered(index + 1, |byte| byte ^ 16), UNREADABLE);
    costs_nothing(&altered(index, |_| op::MESSAGE), "the head of a message index was altered");
    costs_nothing(&altered(index + 9, |byte| byte ^ 1), "an index does not describe what is there");
    let mut file = recording("zstd");
    file[index as usize + 9..index as usize + 31].fill(0xff);
    costs_nothing(&file, UNREADABLE);
}

/// Just as many bytes of it and behind it are gone as its first indexes have: its length leads to the next record still, and
/// the indexes that are left do not name all of its messages.
#[test]
fn what_is_lost_with_a_chunk_and_its_indexes_is_counted() {
    let whole = recording("zstd");
    let all = records(&whole);
    let chunk = all.iter().rposition(|record| record.0 == op::CHUNK).unwrap();
    let indexes = all[chunk + 1..].iter().take_while(|record| record.0 == op::MESSAGE_INDEX).count();
    assert_eq!(indexes, 3);
    for gone in 1..=indexes {
        let from = all[chunk].2 - 40;
        let bytes = all[chunk + gone].2 - all[chunk].2;
        let mut file = whole.clone();
        file.drain(from as usize..(from + bytes) as usize);
        let Account { messages, lost, lost_unknown, .. } = read(&file).account;
        assert!(messages < MESSAGES && !lost_unknown, "{gone}");
        assert_eq!(messages + lost, MESSAGES, "{gone}");
    }
}

#[test]
fn the_summary_is_not_needed() {
    let bad_sum = "the summary's checksum does not agree";
    costs_nothing(&altered(places(op::STATISTICS)[0] + 9, |byte| byte ^ 1), bad_sum);
    costs_nothing(&altered(places(op::CHUNK_INDEX)[0] + 30, |byte| byte ^ 1), bad_sum);
    let mut file = recording("zstd");
    file.extend_from_slice(b"\x89MCAP0\r");
    costs_nothing(&file, "something comes after the end mark");
    let length = recording("zstd").len();
    for cut in [1, 8, 20, 60] {
        file.truncate(length - cut);
        let damaged = read(&file);
        assert_eq!((damaged.account.messages, damaged.account.is_lossless()), (MESSAGES, true));
        assert!(!damaged.account.is_whole(), "{cut}");
    }
    // A schema of the summary that became a private record: two findings, and still nothing lost.
    let schema = places(op::SCHEMA).into_iter().next_back().unwrap();
    let damaged = read(&altered(schema, |byte| byte | 0x80));
    assert_eq!((damaged.account.messages, damaged.account.is_lossless()), (MESSAGES, true));
    assert!(damaged.account.findings.iter().any(|finding| finding.problem == bad_sum));
}

#[test]
fn definitions_that_are_lost_in_the_data_are_taken_from_the_summary() {
    let mut file = recording("zstd");
    let chunk = places(op::CHUNK)[0] as usize;
    file[chunk + 60..chunk + 120].fill(0xa5);
    let damaged = read(&file);
    assert!(damaged.account.lost > 0 && damaged.account.messages > 0, "{:#?}", damaged.account);
    assert_eq!(damaged.account.messages + damaged.account.lost, MESSAGES);
    assert_eq!(read(&repaired(&file)).messages, damaged.messages);
}

#[test]
fn a_file_that_was_cut_keeps_what_was_unpacked_of_its_last_chunk() {
    let chunks = places(op::CHUNK);
    let file = recording("");
    let mut uncompressed = records(&file).into_iter().filter(|record| record.0 == op::CHUNK).map(|record| record.1);
    let last = uncompressed.next_back().unwrap() as usize;
    let before = read(&file[..last]).account.messages;
    let cut = read(&file[..last + 2000]);
    assert!(cut.account.cut && !cut.account.is_lossless());
    assert!(cut.account.messages > before, "{:#?}", cut.account);
    assert_eq!(cut.account.doubtful, cut.account.messages - before, "what no checksum covers is doubtful");
    // Cut between two records: what came after is lost, what came before is as it was.
    let cut = read(&recording("zstd")[..chunks[1] as usize]);
    assert_eq!(cut.account.findings.last().map(|finding| finding.problem.as_str()), Some(CUT));
    assert!(cut.account.doubtful == 0 && cut.account.messages > 0);
    assert_eq!(cut.account.outcome(), "what came after its end is lost");
}

#[test]
fn an_altered_attachment_costs_itself_only() {
    let attachment = places(op::ATTACHMENT)[0];
    let file = altered(attachment + 70, |byte| byte ^ 1);
    let damaged = read(&file);
    assert_eq!(
        found(&damaged),
        (MESSAGES, 0, 0, "the checksum of attachment `config.toml` does not agree with its content")
    );
    assert!(!damaged.account.is_lossless());
    let whole = read(&repaired(&file));
    assert!(whole.account.is_whole());
    assert!(whole.others.iter().any(|other| other.contains("config.toml.altered")), "{:?}", whole.others);
    assert!(!whole.others.iter().any(|other| other.contains("\"config.toml\"")), "{:?}", whole.others);
}

#[test]
fn an_attachment_shorter_than_it_says_does_not_panic() {
    // Two times, two texts, a length, and no room for the checksum.
    let mut raw = Raw::new();
    let mut body = vec![0; 16];
    body.extend([1, 0, 0, 0, b'a', 1, 0, 0, 0, b'b']);
    body.extend(0u64.to_le_bytes());
    raw.record(op::ATTACHMENT, &body);
    let cut = read(raw.bytes());
    assert_eq!(cut.account.messages, 0);
    assert!(cut.account.cut && cut.account.findings.len() == 2, "{:#?}", cut.account);
    raw.definitions();
    raw.messages(1..4);
    let whole = read(&raw.end(0));
    assert_eq!((whole.account.messages, whole.account.findings[0].problem.as_str()), (3, UNREADABLE));
    assert_eq!(whole.account.findings[0].cost, Cost::Record);
}

#[test]
fn a_data_checksum_that_does_not_agree_is_said() {
    let damaged = read(&altered(places(op::METADATA)[0] + 15, |byte| byte ^ 0x20));
    assert_eq!(found(&damaged), (MESSAGES, 0, 0, DATA_SUM));
    assert!(!damaged.account.is_lossless(), "which record was altered is not known");
    let mut raw = Raw::new();
    raw.definitions();
    raw.messages(1..4);
    let damaged = read(&raw.end(77));
    assert_eq!(found(&damaged), (3, 0, 0, DATA_SUM));
    assert!(!damaged.account.is_lossless());
}

#[test]
fn records_that_may_not_be_in_a_chunk_cost_nothing() {
    let mut raw = Raw::new();
    raw.definitions();
    let message = crate::maker::message(1, 7);
    raw.chunk(&[(op::DATA_END, &[0; 4]), (op::MESSAGE, &message)]);
    raw.messages(8..10);
    let read = read(&raw.end(0));
    assert_eq!((read.account.messages, read.account.is_lossless()), (3, true));
    assert_eq!(read.account.findings[0].problem, "a record of type 0x0f may not stand here");
}

#[test]
fn a_bad_schema_or_channel_costs_its_own_messages_only() {
    let schema_id0 = crate::maker::schema(0, "s");
    let mut raw = Raw::new();
    raw.record(op::SCHEMA, &schema_id0);
    raw.definitions();
    raw.messages(1..4);
    assert_eq!(found(&read(&raw.clone().end(0))), (3, 0, 0, "schema 0 is not valid, or contradicts an earlier one"));

    let mut unknown = raw.clone();
    unknown.record(op::CHANNEL, &crate::maker::channel(2, 9, "/t"));
    unknown.record(op::MESSAGE, &crate::maker::message(2, 4));
    unknown.messages(5..7);
    let damaged = read(&unknown.end(0));
    assert_eq!((damaged.account.messages, damaged.account.lost), (5, 1));
    assert!(
        damaged.account.lines()[1].contains("channel 2 cannot be read: its schema is not in the file; 1 message lost")
    );

    let mut conflict = raw.clone();
    conflict.record(op::CHANNEL, &crate::maker::channel(1, 1, "/other"));
    conflict.messages(5..8);
    conflict.record(op::CHANNEL, &crate::maker::channel(3, 1, "/third"));
    conflict.record(op::MESSAGE, &crate::maker::message(3, 9));
    let damaged = read(&conflict.end(0));
    assert_eq!((damaged.account.messages, damaged.account.lost), (4, 3), "{:#?}", damaged.account);
}

#[test]
fn a_bomb_is_left_where_the_limit_is() {
    let limits = Limits { chunk_bytes: 1 << 20, ..Limits::default() };
    let mut raw = Raw::new();
    raw.definitions();
    raw.messages(1..4);
    // Empty records of a kind that is none: a few bytes become millions of records.
    raw.packed(&vec![0; 64 << 20]);
    raw.messages(5..8);
    let file = raw.end(0);
    let read = crate::maker::read_within(&file, &limits);
    assert_eq!(read.account.messages, 6);
    assert!(read.account.findings[0].problem.contains("or is bigger than is read"), "{:#?}", read.account);
    assert!(!read.account.is_lossless());

    // Many such chunks together: the whole file has a limit, too.
    let mut raw = Raw::new();
    raw.definitions();
    for _ in 0..200 {
        raw.packed(&vec![0; 1 << 20]);
    }
    let limits = Limits { chunk_bytes: 1 << 20, total_bytes: 8 << 20, total_factor: 1, ..Limits::default() };
    let read = crate::maker::read_within(&raw.end(0), &limits);
    assert!(read.account.further > 100, "{:#?}", read.account.findings.len());
    assert!(!read.account.is_lossless());
}

#[test]
fn a_record_bigger_than_is_read_is_passed_over() {
    let mut raw = Raw::new();
    raw.definitions();
    raw.record(op::MESSAGE, &[crate::maker::message(1, 1), vec![7; 5000]].concat());
    raw.messages(2..4);
    let limits = Limits { record_bytes: 4096, ..Limits::default() };
    let read = crate::maker::read_within(&raw.end(0), &limits);
    assert_eq!((read.account.messages, read.account.lost), (2, 1));
    assert_eq!(read.account.findings[0].times_ns, Some((crate::maker::time_ns(2), crate::maker::time_ns(2))));
}

#[test]
fn what_is_no_mcap_is_refused() {
    use salvage::ReadError;
    let none = |_: mcap::records::Record<'_>, _| Ok::<_, std::convert::Infallible>(());
    assert!(matches!(salvage::read(&&b""[..], &Limits::default(), none), Err(ReadError::Empty)));
    assert!(matches!(salvage::read(&&b"\x89MCAP"[..], &Limits::default(), none), Err(ReadError::NotMcap)));
    assert!(matches!(salvage::read(&&[7u8; 4096][..], &Limits::default(), none), Err(ReadError::NotMcap)));
    costs_nothing(&altered(3, |byte| byte ^ 1), "the magic bytes at the beginning were altered");
}

#[test]
fn private_records_and_names_are_kept() {
    let others = read(&recording("zstd")).others;
    for part in ["Header { profile: \"ours\", library: \"maker\" }", "opcode: 144", "notes", "config.toml"] {
        assert!(others.iter().any(|other| other.contains(part)), "{part}: {others:?}");
    }
    assert_eq!(read(&repaired(&recording("zstd"))).others, others);
}
