//! Recorded messages about episodes, read: the fields of a [`Form`] are found by name, whatever their numbers were.

use super::engine::OWN;
use super::form::{FieldSource, Form, Slot, Told, wire_of};
use prost::Message;
use prost::bytes::Buf;
use prost::encoding::{DecodeContext, WireType, decode_key, decode_varint, skip_field};
use prost_types::field_descriptor_proto::Label;
use prost_types::{FieldDescriptorProto, FileDescriptorSet};
use std::collections::HashMap;
use std::sync::Arc;

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MessageError {
    #[error("it has no schema, or a damaged one")]
    NoSchema,
    #[error("its messages have no field `{0}` as the task declares it: they were recorded under another declaration")]
    NoField(String),
    #[error("a message is damaged: {0}")]
    Damaged(String),
    #[error("a message's {field} is {bits:#x}, which cannot be")]
    Number { field: String, bits: u64 },
}

impl From<prost::DecodeError> for MessageError {
    fn from(cause: prost::DecodeError) -> Self {
        Self::Damaged(cause.to_string())
    }
}

/// How the messages of a recording's channel are read: the fields of a form by the numbers that they were recorded under.
#[derive(Debug, Clone)]
pub struct Reading {
    form: Arc<Form>,
    slots: HashMap<u32, usize>,
}

impl Reading {
    pub fn of(form: &Form, descriptor: &[u8]) -> Result<Self, MessageError> {
        let set = FileDescriptorSet::decode(descriptor).map_err(|_| MessageError::NoSchema)?;
        let mut messages = set.file.iter().flat_map(|file| &file.message_type);
        let message = messages.find(|message| message.name() == form.message).ok_or(MessageError::NoSchema)?;
        let number = |slot: &Slot| {
            let is_it = |field: &&FieldDescriptorProto| {
                let same = wire_of(field.r#type()) == slot.wire;
                field.name() == slot.name && same && (field.label() == Label::Repeated) == slot.is_list
            };
            let field = message.field.iter().find(is_it);
            field.map(|field| field.number() as u32).ok_or_else(|| MessageError::NoField(slot.name.clone()))
        };
        let slots = form.slots.iter().enumerate().map(|(at, slot)| Ok((number(slot)?, at)));
        Ok(Self { slots: slots.collect::<Result<_, MessageError>>()?, form: Arc::new(form.clone()) })
    }

    pub fn read(&self, mut data: &[u8]) -> Result<Told, MessageError> {
        let mut told = self.form.empty.clone();
        while data.has_remaining() {
            let (number, wire) = decode_key(&mut data)?;
            let Some(&slot) = self.slots.get(&number) else {
                skip_field(wire, number, &mut data, DecodeContext::default())?;
                continue;
            };
            let slot = &self.form.slots[slot];
            let own = slot.wire;
            if wire == own && !slot.is_list {
                take(slot, 0, number_from(own, &mut data)?, &mut told)?;
            } else if wire == WireType::LengthDelimited && slot.is_list {
                let length = decode_varint(&mut data)?;
                let damaged = || MessageError::Damaged(format!("its {} is cut off", slot.name));
                let length = usize::try_from(length).ok().filter(|&length| length <= data.len()).ok_or_else(damaged)?;
                let (mut list, rest) = data.split_at(length);
                data = rest;
                let mut at = 0;
                while list.has_remaining() {
                    take(slot, at, number_from(own, &mut list)?, &mut told)?;
                    at += 1;
                }
            } else {
                return Err(MessageError::Damaged(format!("its {} is of another type", slot.name)));
            }
        }
        Ok(told)
    }
}

fn take(slot: &Slot, at: usize, bits: u64, told: &mut Told) -> Result<(), MessageError> {
    let fits = match slot.place {
        FieldSource::Engine(own) => (OWN[own].set)(&mut told.engine, bits),
        FieldSource::Record(field, _) if at >= field.count => false,
        FieldSource::Record(field, is_seen) => {
            told.seen |= is_seen;
            let offset = field.offset + at * field.dtype.bytes();
            field.dtype.write(bits, &mut told.record[offset..])
        }
        FieldSource::Reward(at) => {
            told.rewards[at] = f32::from_bits(bits as u32);
            true
        }
        FieldSource::Return(at) => {
            told.returns[at] = Some(f64::from_bits(bits));
            true
        }
        FieldSource::Metric(at) => {
            told.metrics[at] = Some(f64::from_bits(bits));
            true
        }
    };
    if fits { Ok(()) } else { Err(MessageError::Number { field: slot.name.clone(), bits }) }
}

fn number_from(wire: WireType, data: &mut &[u8]) -> Result<u64, MessageError> {
    let cut = |_| MessageError::Damaged("it is cut off".to_owned());
    match wire {
        WireType::ThirtyTwoBit => data.try_get_u32_le().map(u64::from).map_err(cut),
        WireType::SixtyFourBit => data.try_get_u64_le().map_err(cut),
        _ => Ok(decode_varint(data)?),
    }
}
