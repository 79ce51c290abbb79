//! A whole file of what can be read of another.

use crate::account::{Account, REPAIR_METADATA};
use crate::reader::{ReadError, read};
use crate::source::Source;
use crate::state::{Limits, Trust};
use mcap::records::{Metadata, Record};
use mcap::write::PrivateRecordOptions;
use mcap::{Attachment, McapError, WriteOptions, Writer};
use std::collections::BTreeMap;
use std::io::{Seek, Write};

/// What an attachment whose content was altered is called after its name.
const ALTERED: &str = ".altered";

/// Why no whole file could be made.
#[derive(Debug, thiserror::Error)]
pub enum RewriteError {
    /// The old one.
    #[error(transparent)]
    Read(ReadError<McapError>),
    #[error(transparent)]
    Write(McapError),
}

/// Writes all that can be read of `source` as a whole file: under the old numbers, with the old profile and library,
/// with attachments, metadata and private records. `options` are for the rest, such as compression.
///
/// If something was lost, the new file says so in its metadata.
pub fn rewrite<W: Write + Seek>(
    source: &impl Source,
    limits: &Limits,
    options: WriteOptions,
    out: W,
) -> Result<Account, RewriteError> {
    let mut copy = Copy::Waiting(options, out);
    let read = read(source, limits, |record, trust| copy.record(record, trust));
    let account = read.map_err(|error| match error {
        ReadError::Visit(error) => RewriteError::Write(error),
        error => RewriteError::Read(error),
    })?;
    copy.finish(&account).map_err(RewriteError::Write)?;
    Ok(account)
}

/// The new file. Its header is the first thing in it, so it begins with the old one's first record.
// There is one at a time.
#[allow(clippy::large_enum_variant)]
enum Copy<W: Write + Seek> {
    Waiting(WriteOptions, W),
    Writing(Writer<W>),
    /// It could not be begun.
    Failed,
}

impl<W: Write + Seek> Copy<W> {
    fn begin(&mut self, names: Option<(&str, &str)>) -> Result<&mut Writer<W>, McapError> {
        match std::mem::replace(self, Self::Failed) {
            Self::Waiting(options, out) => {
                let options = match names {
                    Some((profile, library)) => options.profile(profile).library(library),
                    None => options,
                };
                *self = Self::Writing(options.create(out)?);
            }
            other => *self = other,
        }
        match self {
            Self::Writing(writer) => Ok(writer),
            _ => Err(McapError::AttemptedWriteAfterFailure),
        }
    }

    fn record(&mut self, record: Record<'_>, trust: Trust) -> Result<(), McapError> {
        if let Record::Header(header) = &record {
            return self.begin(Some((&header.profile, &header.library))).map(drop);
        }
        let writer = self.begin(None)?;
        match record {
            Record::Schema { header, data } => {
                writer.add_schema_with_id(header.id, &header.name, &header.encoding, &data).map(drop)
            }
            Record::Channel(channel) => {
                let (topic, encoding) = (&channel.topic, &channel.message_encoding);
                writer.add_channel_with_id(channel.id, channel.schema_id, topic, encoding, &channel.metadata).map(drop)
            }
            Record::Message { header, data } => writer.write_to_known_channel(&header, &data),
            Record::Attachment { header, data, .. } => {
                let altered = if trust == Trust::Doubtful { ALTERED } else { "" };
                let name = format!("{}{altered}", header.name);
                let (log_time, create_time, media_type) = (header.log_time, header.create_time, header.media_type);
                writer.attach(&Attachment { log_time, create_time, name, media_type, data })
            }
            Record::Metadata(metadata) => writer.write_metadata(&metadata),
            Record::Unknown { opcode, data } => {
                writer.write_private_record(opcode, &data, PrivateRecordOptions::IncludeInChunks.into())
            }
            _ => Ok(()),
        }
    }

    fn finish(mut self, account: &Account) -> Result<(), McapError> {
        let writer = self.begin(None)?;
        if !account.is_lossless() {
            let mut metadata = BTreeMap::from([("outcome".to_owned(), account.outcome())]);
            let findings = account.lines().into_iter().enumerate();
            metadata.extend(findings.map(|(number, line)| (format!("finding-{number:02}"), line)));
            writer.write_metadata(&Metadata { name: REPAIR_METADATA.to_owned(), metadata })?;
        }
        writer.finish().map(drop)
    }
}
