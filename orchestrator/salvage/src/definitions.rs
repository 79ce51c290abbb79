use crate::account::{Cost, Finding};
use crate::state::{Outcome, Reader, Trust};
use crate::summary::Schema;
use mcap::records::{Channel, MessageHeader, Record};
use std::borrow::Cow;

impl<E> Reader<'_, E> {
    /// Hands a schema on, if it is new. `place` is where it or its chunk is.
    pub(crate) fn schema(&mut self, place: u64, schema: Schema) -> Outcome<(), E> {
        let id = schema.0.id;
        let known = self.definitions.schemas.get(&id);
        if known == Some(&schema) {
            return Ok(());
        }
        let bytes = schema.0.name.len() + schema.0.encoding.len() + schema.1.len();
        if known.is_some() || id == 0 || !self.definitions.keep(bytes) {
            let cost = if id == 0 { Cost::Nothing } else { Cost::Record };
            self.finding(place..place, format!("schema {id} is not valid, or contradicts an earlier one"), cost, None);
            return Ok(());
        }
        let (header, data) = schema.clone();
        self.definitions.schemas.insert(id, schema);
        self.hand_on(Record::Schema { header, data: data.into() }, Trust::Sound)
    }

    /// Hands a channel on, if it is new, and before it its schema, if only the summary has that.
    pub(crate) fn channel(&mut self, place: u64, channel: Channel) -> Outcome<(), E> {
        let (id, schema_id) = (channel.id, channel.schema_id);
        let known = self.definitions.channels.get(&id).map(|known| known.as_ref() == Ok(&channel));
        if known == Some(true) {
            return Ok(());
        }
        if !self.definitions.schemas.contains_key(&schema_id)
            && let Some(schema) = self.summary.as_ref().and_then(|summary| summary.schemas.get(&schema_id))
        {
            self.schema(place, schema.clone())?;
        }
        let pairs = channel.metadata.iter().map(|(key, value)| key.len() + value.len() + 64);
        let bytes = channel.topic.len() + channel.message_encoding.len() + pairs.sum::<usize>();
        let channel = if known.is_some() {
            Err("two different channels have this number")
        } else if schema_id != 0 && !self.definitions.schemas.contains_key(&schema_id) {
            Err("its schema is not in the file")
        } else if !self.definitions.keep(bytes) {
            Err("there are too many channels")
        } else {
            self.hand_on(Record::Channel(channel.clone()), Trust::Sound)?;
            Ok(channel)
        };
        self.definitions.channels.insert(id, channel.map_err(|why| unreadable(place, id, why)));
        Ok(())
    }

    pub(crate) fn message(&mut self, place: u64, header: MessageHeader, data: &[u8], trust: Trust) -> Outcome<(), E> {
        let (id, time_ns) = (header.channel_id, header.log_time);
        if !self.definitions.channels.contains_key(&id)
            && let Some(channel) = self.summary.as_ref().and_then(|summary| summary.channels.get(&id))
        {
            self.channel(place, channel.clone())?;
        }
        let channel = self.definitions.channels.entry(id);
        if let Err(lost) = channel.or_insert_with(|| Err(unreadable(place, id, "it is not in the file"))) {
            lost.cost = Cost::Lost(if let Cost::Lost(count) = lost.cost { count + 1 } else { 1 });
            let (from, to) = lost.times_ns.unwrap_or((time_ns, time_ns));
            lost.times_ns = Some((from.min(time_ns), to.max(time_ns)));
            return Ok(());
        }
        if let Some(region) = self.region.take().and_then(|region| self.account.findings.get_mut(region)) {
            region.times_ns = Some((self.time_ns.unwrap_or(time_ns), time_ns));
        }
        self.time_ns = Some(time_ns);
        self.account.messages += 1;
        self.account.doubtful += u64::from(trust == Trust::Doubtful);
        self.hand_on(Record::Message { header, data: Cow::Borrowed(data) }, trust)
    }

    pub(crate) fn has_channel(&self, id: u16) -> bool {
        let spare = || self.summary.as_ref().is_some_and(|summary| summary.channels.contains_key(&id));
        self.definitions.channels.get(&id).map_or_else(spare, Result::is_ok)
    }

    pub(crate) fn settle_channels(&mut self) {
        for lost in std::mem::take(&mut self.definitions.channels).into_values().filter_map(Result::err) {
            self.account.add(lost);
        }
    }
}

fn unreadable(offset: u64, id: u16, why: &str) -> Finding {
    let problem = format!("messages of channel {id} cannot be read: {why}");
    Finding { offset, bytes: 0, problem, cost: Cost::Nothing, times_ns: None }
}
