use crate::account::{Account, REPAIR_METADATA};
use crate::layout::{Frame, Next, each_record, is_private, next, parse};
use crate::source::Source;
use mcap::MAGIC;
use mcap::records::{Channel, Record, SchemaHeader, op};
use std::collections::HashMap;
use std::collections::hash_map::Entry;

#[derive(Debug, thiserror::Error)]
pub enum ReadError<E> {
    #[error("it is empty")]
    Empty,
    #[error("it does not begin with MCAP's magic bytes")]
    NotMcap,
    #[error(transparent)]
    Io(#[from] std::io::Error),
    #[error(transparent)]
    Visit(E),
}

/// Hands every record of the data to `visit`, those inside chunks in their place: header, schemas, channels, messages,
/// attachments, metadata and private records. Channels come before their messages, schemas before their channels, each
/// once.
///
/// Damage is no error: it is in the account. An error of `visit` ends the reading.
pub fn read<E>(source: &impl Source, visit: impl FnMut(Record<'_>) -> Result<(), E>) -> Result<Account, ReadError<E>> {
    let (length, start) = (source.length(), MAGIC.len() as u64);
    if length == 0 {
        return Err(ReadError::Empty);
    }
    if length < start || source.bytes(0..start)? != MAGIC {
        return Err(ReadError::NotMcap);
    }
    let mut reader = Reader {
        visit,
        account: Account::default(),
        schemas: HashMap::new(),
        channels: HashMap::new(),
        others: 0,
        place: start,
    };
    if let Some(data_end) = reader.data(source)? {
        reader.end(source, data_end)?;
    }
    Ok(reader.account)
}

struct Reader<V> {
    visit: V,
    account: Account,
    schemas: HashMap<u16, (SchemaHeader, Vec<u8>)>,
    channels: HashMap<u16, Channel>,
    /// Attachments and metadata.
    others: u64,
    place: u64,
}

impl<V> Reader<V> {
    fn loss(&mut self, problem: &str) {
        self.account.find(self.place, problem, true);
    }

    /// Reads up to the mark that ends the data; none if there is none.
    fn data<E>(&mut self, source: &impl Source) -> Result<Option<Frame>, ReadError<E>>
    where
        V: FnMut(Record<'_>) -> Result<(), E>,
    {
        loop {
            let frame = match next(source, self.place)? {
                Next::Record(frame) => frame,
                Next::Cut => {
                    self.account.cut = true;
                    self.loss("the file ends here, before its end mark");
                    return Ok(None);
                }
                Next::Damaged => {
                    self.loss("no record can be recognised from here on");
                    return Ok(None);
                }
            };
            match frame.opcode {
                op::DATA_END => return Ok(Some(frame)),
                // Indexes are not needed.
                op::MESSAGE_INDEX => {}
                op::CHUNK => {
                    let mut records = Vec::new();
                    let all = each_record(&frame.content(source)?, |record| records.push(record.into_owned()));
                    match all {
                        Some(()) => records.into_iter().try_for_each(|record| self.take(record))?,
                        None => self.loss("a chunk's content is not what its checksum says, or cannot be unpacked"),
                    }
                }
                opcode => match parse(opcode, &frame.content(source)?) {
                    Some(record) => self.take(record)?,
                    None => self.loss("a record was altered"),
                },
            }
            self.place = frame.end;
        }
    }

    fn take<E>(&mut self, record: Record<'_>) -> Result<(), ReadError<E>>
    where
        V: FnMut(Record<'_>) -> Result<(), E>,
    {
        match &record {
            Record::Schema { header, data } => {
                let defined = (header.clone(), data.to_vec());
                match self.schemas.entry(header.id) {
                    Entry::Occupied(known) if *known.get() == defined => return Ok(()),
                    Entry::Vacant(new) if header.id != 0 => drop(new.insert(defined)),
                    _ => return Ok(self.loss("a schema has another's number")),
                }
            }
            Record::Channel(channel) => {
                let is_defined = channel.schema_id == 0 || self.schemas.contains_key(&channel.schema_id);
                match self.channels.entry(channel.id) {
                    Entry::Occupied(known) if known.get() == channel => return Ok(()),
                    Entry::Vacant(new) if is_defined => drop(new.insert(channel.clone())),
                    _ => return Ok(self.loss("a channel has another's number, or no schema")),
                }
            }
            Record::Message { header, .. } if self.channels.contains_key(&header.channel_id) => {
                self.account.messages += 1;
            }
            Record::Message { .. } => return Ok(self.loss("a message is of no channel that there is")),
            Record::Attachment { .. } => self.others += 1,
            Record::Metadata(metadata) => {
                self.others += 1;
                if let Some(outcome) = metadata.metadata.get("outcome").filter(|_| metadata.name == REPAIR_METADATA) {
                    self.account.repaired_with_loss = Some(outcome.clone());
                }
            }
            Record::Header(_) if self.place == MAGIC.len() as u64 => {}
            Record::Unknown { opcode, .. } if is_private(*opcode) => {}
            _ => return Ok(self.loss("a record stands where it may not")),
        }
        (self.visit)(record).map_err(ReadError::Visit)
    }

    /// Reads what comes after the data, and compares it with what there was.
    fn end<E>(&mut self, source: &impl Source, data_end: Frame) -> Result<(), ReadError<E>> {
        if let Some(Record::DataEnd(end)) = parse(op::DATA_END, &data_end.content(source)?)
            && end.data_section_crc != 0
            && self.account.is_whole()
            && end.data_section_crc != sum(source, data_end.offset)?
        {
            self.account.find(0, "the checksum over all data does not agree: something was altered", true);
        }
        self.place = data_end.end;
        let has_ended = loop {
            let Next::Record(frame) = next(source, self.place)? else { break false };
            self.place = frame.end;
            match frame.opcode {
                op::FOOTER => break source.bytes(frame.end..source.length())? == MAGIC,
                op::STATISTICS => {
                    let content = frame.content(source)?;
                    let Some(Record::Statistics(counted)) = parse(frame.opcode, &content) else { break false };
                    self.account.missing = counted.message_count.saturating_sub(self.account.messages);
                    let others = u64::from(counted.attachment_count) + u64::from(counted.metadata_count);
                    if counted.message_count != self.account.messages || others > self.others {
                        self.loss("the statistics count other records than there are");
                    }
                }
                _ => {}
            }
        };
        if !has_ended {
            self.account.cut = true;
            self.account.find(self.place, "the file ends here, before its end mark", false);
        }
        Ok(())
    }
}

fn sum(source: &impl Source, end: u64) -> std::io::Result<u32> {
    const BLOCK_BYTES: u64 = 256 << 10;
    let mut hasher = crc32fast::Hasher::new();
    for start in (0..end).step_by(BLOCK_BYTES as usize) {
        hasher.update(&source.bytes(start..end.min(start + BLOCK_BYTES))?);
    }
    Ok(hasher.finalize())
}
