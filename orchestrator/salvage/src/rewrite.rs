use crate::account::{Account, REPAIR_METADATA};
use crate::reader::{header, read};
use crate::source::Source;
use crate::state::{Limits, ReadError, Trust};
use mcap::records::{Metadata, Record};
use mcap::write::PrivateRecordOptions;
use mcap::{Attachment, McapError, WriteOptions, Writer};
use std::collections::BTreeMap;
use std::io::{Seek, Write};

/// What an attachment whose content was altered is called after its name.
const ALTERED: &str = ".altered";

/// Writes all that can be read of `source` as a whole file: under the old numbers, with the old profile and library,
/// with attachments, metadata and private records. `options` are for the rest, such as compression.
///
/// If something was lost, the new file says so in its metadata. [`ReadError::Visit`] is an error of the new file.
pub fn rewrite<W: Write + Seek>(
    source: &impl Source,
    limits: &Limits,
    options: WriteOptions,
    out: W,
) -> Result<Account, ReadError<McapError>> {
    let options = match header(source)? {
        Some(header) => options.profile(header.profile).library(header.library),
        None => options,
    };
    let mut writer = options.create(out).map_err(ReadError::Visit)?;
    let account = read(source, limits, |record, trust| copy(record, trust, &mut writer))?;
    finish(writer, &account).map_err(ReadError::Visit)?;
    Ok(account)
}

fn copy<W: Write + Seek>(record: Record<'_>, trust: Trust, writer: &mut Writer<W>) -> Result<(), McapError> {
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

fn finish<W: Write + Seek>(mut writer: Writer<W>, account: &Account) -> Result<(), McapError> {
    if !account.is_lossless() {
        let mut metadata = BTreeMap::from([("outcome".to_owned(), account.outcome())]);
        let findings = account.lines().into_iter().enumerate();
        metadata.extend(findings.map(|(number, line)| (format!("finding-{number:02}"), line)));
        writer.write_metadata(&Metadata { name: REPAIR_METADATA.to_owned(), metadata })?;
    }
    writer.finish().map(drop)
}
