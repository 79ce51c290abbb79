//! Schemas and channels: which messages can be read.

use mcap::records::{Channel, Record, SchemaHeader};
use std::borrow::Cow;
use std::collections::{HashMap, HashSet};

/// What is kept of schemas and channels at most, bytes.
const KEPT_BYTES_MAX: u64 = 64 << 20;

/// A schema as a record carries it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Schema {
    /// Number, name and encoding.
    pub header: SchemaHeader,
    /// The description itself.
    pub data: Vec<u8>,
}

/// What became of a definition.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Defined {
    /// It is new, and stands.
    New,
    /// It repeats what is known.
    Known,
    /// It cannot be one, or contradicts an earlier one.
    Refused,
}

/// Why a channel's messages cannot be read.
type Why = &'static str;

/// Schemas and channels so far.
#[derive(Debug, Default)]
pub struct Definitions {
    schemas: HashMap<u16, Schema>,
    contested: HashSet<u16>,
    channels: HashMap<u16, Result<Channel, Why>>,
    /// Those of the file's summary, for what is lost or altered in the data.
    spare_schemas: HashMap<u16, Schema>,
    spare_channels: HashMap<u16, Channel>,
    /// The summary has a checksum, and it agrees.
    spare_proven: bool,
    kept_bytes: u64,
}

impl Definitions {
    /// Takes a record of the file's summary.
    pub fn spare(&mut self, record: &Record<'_>, proven: bool) {
        self.spare_proven = proven;
        match record {
            Record::Schema { header, data } if header.id != 0 && self.keep(data.len()) => {
                let schema = Schema { header: header.clone(), data: data.to_vec() };
                self.spare_schemas.entry(header.id).or_insert(schema);
            }
            Record::Channel(channel) if self.keep(channel.topic.len()) => {
                self.spare_channels.entry(channel.id).or_insert_with(|| channel.clone());
            }
            _ => {}
        }
    }

    /// Takes a schema of the data. `doubtful`: its chunk was altered, so the summary's word counts more.
    pub fn schema(&mut self, schema: Schema, doubtful: bool) -> Defined {
        let id = schema.header.id;
        let schema = match self.spare_schemas.get(&id) {
            Some(spare) if doubtful && self.spare_proven => spare.clone(),
            _ => schema,
        };
        match self.schemas.get(&id).map(|known| *known == schema) {
            Some(true) => Defined::Known,
            Some(false) => {
                self.contested.insert(id);
                Defined::Refused
            }
            None if id != 0 && self.keep(schema.data.len()) => {
                self.schemas.insert(id, schema);
                Defined::New
            }
            None => Defined::Refused,
        }
    }

    /// Takes a channel of the data.
    pub fn channel(&mut self, channel: Channel, doubtful: bool) -> Defined {
        let id = channel.id;
        let channel = match self.spare_channels.get(&id) {
            Some(spare) if doubtful && self.spare_proven => spare.clone(),
            _ => channel,
        };
        let known = self.channels.get(&id).map(|known| known.as_ref() == Ok(&channel));
        let outcome = match known {
            Some(true) => return Defined::Known,
            Some(false) => Err("two different channels have this number"),
            None if !self.keep(channel.topic.len()) => Err("there are too many channels"),
            None if self.contested.contains(&channel.schema_id) => {
                Err("two different schemas have its schema's number")
            }
            None if !self.has_schema(channel.schema_id) => Err("its schema is not in the file"),
            None => Ok(channel),
        };
        let defined = if outcome.is_ok() { Defined::New } else { Defined::Refused };
        self.channels.insert(id, outcome);
        defined
    }

    /// Whether messages of this channel can be read, now or with the summary's help.
    pub fn has_channel(&self, id: u16) -> bool {
        self.channels.get(&id).map_or(self.spare_channels.contains_key(&id), Result::is_ok)
    }

    /// The channel of a message: whether it is known, or why it cannot be read. One that only the summary has is
    /// defined by this.
    pub fn find(&mut self, id: u16) -> (Defined, Result<&Channel, Why>) {
        let defined = match (self.channels.contains_key(&id), self.spare_channels.get(&id)) {
            (false, Some(spare)) => {
                let spare = spare.clone();
                self.channel(spare, false)
            }
            _ => Defined::Known,
        };
        let channel = match self.channels.get(&id) {
            Some(Ok(channel)) => Ok(channel),
            Some(Err(why)) => Err(*why),
            None => Err("it is not in the file"),
        };
        (defined, channel)
    }

    /// The schema of a channel as a record, if it has one.
    pub fn schema_record(&self, id: u16) -> Option<Record<'_>> {
        let schema = self.schemas.get(&id)?;
        Some(Record::Schema { header: schema.header.clone(), data: Cow::Borrowed(&schema.data) })
    }

    fn has_schema(&mut self, id: u16) -> bool {
        if id != 0
            && !self.schemas.contains_key(&id)
            && let Some(spare) = self.spare_schemas.get(&id)
        {
            self.schemas.insert(id, spare.clone());
        }
        id == 0 || self.schemas.contains_key(&id)
    }

    fn keep(&mut self, bytes: usize) -> bool {
        self.kept_bytes += bytes as u64 + 64;
        self.kept_bytes <= KEPT_BYTES_MAX
    }
}
