//! What is known of the chunk that was read last.

use crate::account::Finding;
use mcap::records::MessageIndex;
use std::collections::HashMap;

/// The chunk that was read last, until its indexes are read.
#[derive(Debug)]
pub struct LastChunk {
    pub offset: u64,
    /// What is wrong with it; what that cost, its indexes may tell.
    pub finding: Option<Finding>,
    /// Messages handed on, and those of channels that cannot be read.
    pub seen: u64,
    /// Log time and place of every message, by channel.
    pub messages: HashMap<u16, Vec<(u64, u64)>>,
    /// Messages that its indexes name, if it has any.
    pub indexed: Option<u64>,
    pub index_broken: bool,
    /// Its lengths agree, so that what follows it was not passed over.
    pub complete: bool,
}

impl LastChunk {
    /// One of its indexes cannot be read.
    pub fn lose_index(&mut self) {
        self.index_broken = true;
    }

    /// Whether the index is that of one of its channels.
    pub fn describes(&mut self, index: &MessageIndex) -> bool {
        let Some(messages) = self.messages.get_mut(&index.channel_id) else { return index.records.is_empty() };
        if messages.len() != index.records.len() {
            return false;
        }
        let mut entries: Vec<_> = index.records.iter().map(|entry| (entry.log_time, entry.offset)).collect();
        entries.sort_unstable();
        messages.sort_unstable();
        entries == *messages
    }
}
