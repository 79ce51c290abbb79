//! Any bytes as an MCAP file: what is counted is what is handed on, and a whole file can be made of it.

use mcap::records::Record;
use salvage::{Account, Limits, ReadError, read, rewrite};
use std::convert::Infallible;

/// Small ones, so that the limits are met, too.
const LIMITS: Limits = Limits { record_bytes: 1 << 20, chunk_bytes: 1 << 20, total_bytes: 4 << 20, total_factor: 16 };

/// Whether they are a file of which every message could be read.
pub fn take(bytes: &[u8]) -> bool {
    let Some((account, messages)) = messages(bytes) else { return false };
    assert_eq!(account.messages, messages.len() as u64);
    assert!(account.is_lossless() || !account.lines().is_empty(), "a loss is told of");
    let mut out = std::io::Cursor::new(Vec::new());
    rewrite(&bytes, &LIMITS, mcap::WriteOptions::new(), &mut out).expect("what was read can be written");
    let unlimited = Limits::default();
    let mut count = 0;
    let again = read(&&out.get_ref()[..], &unlimited, |record, _| {
        count += usize::from(matches!(record, Record::Message { .. }));
        Ok::<_, Infallible>(())
    })
    .expect("what was written is read");
    assert!(again.is_whole(), "{:?}", again.lines());
    assert_eq!(count, messages.len());
    account.is_lossless()
}

/// What is said of the file, and the content of all its messages; none if it is no MCAP file.
fn messages(bytes: &[u8]) -> Option<(Account, Vec<Vec<u8>>)> {
    let mut messages = Vec::new();
    let read = read(&bytes, &LIMITS, |record, _| {
        if let Record::Message { data, .. } = record {
            messages.push(data.into_owned());
        }
        Ok::<_, Infallible>(())
    });
    match read {
        Ok(account) => Some((account, messages)),
        Err(ReadError::Empty | ReadError::NotMcap) => None,
        Err(error) => panic!("memory can be read: {error}"),
    }
}
