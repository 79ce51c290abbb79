//! Places in a file that its end names.

use mcap::records::{Footer, Record, Statistics};

/// What the end is compared with, and how far it has come.
#[derive(Debug, Default)]
// Independent facts about a file's end.
#[allow(clippy::struct_excessive_bools)]
pub struct Ending {
    /// Place and length of every chunk, in order.
    pub chunks: Vec<(u64, u64)>,
    pub indexes: Vec<u64>,
    pub attachments: Vec<u64>,
    pub metadata: Vec<u64>,
    /// Where the summary begins: after the mark of the data's end.
    pub data_end: Option<u64>,
    pub marked: bool,
    /// The footer points to the summary.
    pub begins: bool,
    pub statistics: Option<Statistics>,
    pub chunk_indexes: usize,
    /// Something in the summary does not describe what is there.
    pub wrong: bool,
    pub footer: Option<Footer>,
    /// The summary has a checksum, and it agrees.
    pub proven: bool,
}

impl Ending {
    /// Whether the mark of the data's end was read.
    pub fn has_data_end(&self) -> bool {
        self.data_end.is_some()
    }

    /// The summary begins without the mark of the data's end.
    pub fn data_ends_unmarked(&mut self, offset: u64) {
        self.data_end = Some(offset);
    }

    /// Whether the footer was read.
    pub fn has_footer(&self) -> bool {
        self.footer.is_some()
    }

    /// Notes a chunk.
    pub fn chunk_at(&mut self, offset: u64, length: u64) {
        self.chunks.push((offset, length));
    }

    /// Notes a message index.
    pub fn index_at(&mut self, offset: u64) {
        self.indexes.push(offset);
    }

    /// Notes an attachment.
    pub fn attachment_at(&mut self, offset: u64) {
        self.attachments.push(offset);
    }

    /// Notes a metadata record.
    pub fn metadata_at(&mut self, offset: u64) {
        self.metadata.push(offset);
    }

    /// Compares an index of the summary with what was read.
    pub fn compare(&mut self, record: &Record<'_>) {
        self.wrong |= match record {
            Record::ChunkIndex(index) => {
                self.chunk_indexes += 1;
                let place = (index.chunk_start_offset, index.chunk_length);
                let indexed = |offset| self.indexes.binary_search(offset).is_ok();
                self.chunks.binary_search(&place).is_err() || !index.message_index_offsets.values().all(indexed)
            }
            Record::AttachmentIndex(index) => self.attachments.binary_search(&index.offset).is_err(),
            Record::MetadataIndex(index) => self.metadata.binary_search(&index.offset).is_err(),
            _ => false,
        };
    }
}
