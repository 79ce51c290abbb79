//! The messages about episodes: `stillroom.Step`, `stillroom.EpisodeStart` and `stillroom.EpisodeEnd`, made of a task's
//! declaration. The engine's fields come first, then the task's by their own names.
//!
//! A [`Form`] writes messages, and describes them in the recording. [`super::reading`] reads them.

#![expect(
    clippy::inline_always,
    reason = "each step is written here, in a crate that is compiled with little optimisation"
)]

use super::engine::{END, Engine, OWN, START, STEP};
use crate::schema::Schema;
use prost::Message;
use prost::encoding::{WireType, encoded_len_varint};
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{
    DescriptorProto, EnumDescriptorProto, EnumValueDescriptorProto, FieldDescriptorProto, FileDescriptorProto,
    FileDescriptorSet, OneofDescriptorProto,
};
use proto::replay::Compared;
use proto::task::{Channel, Dtype, Field, Spec};
use std::collections::BTreeSet;

#[derive(Debug, Clone, PartialEq, Default)]
pub struct Told {
    pub engine: Engine,
    /// The small part of a record of the task: of a step its action, what that did, and what it was chosen from; of a
    /// start what was seen first.
    pub record: Vec<u8>,
    /// What was seen is there: a recorder that missed it writes none.
    pub seen: bool,
    pub rewards: Vec<f32>,
    /// Of an end: returns under those rewards, and the task's metrics. Those that a recorder cannot know, because it did
    /// not see the whole episode, are absent.
    pub returns: Vec<Option<f64>>,
    pub metrics: Vec<Option<f64>>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FieldSource {
    Engine(usize),
    /// Of the record; whether it is of what was seen.
    Record(Field, bool),
    Reward(usize),
    Return(usize),
    Metric(usize),
}

#[derive(Debug, Clone)]
pub struct Slot {
    pub name: String,
    pub place: FieldSource,
    kind: Type,
    pub wire: WireType,
    key: u64,
    names: Vec<String>,
    pub is_list: bool,
    /// It can be absent, and 0 is written.
    is_optional: bool,
}

/// A message, as this program writes it. A field's number is its position, from 1.
#[derive(Debug, Clone)]
pub struct Form {
    pub message: &'static str,
    pub slots: Vec<Slot>,
    longest: usize,
    pub empty: Told,
}

#[derive(Debug, Clone)]
pub struct Forms {
    pub step: Form,
    pub start: Form,
    pub end: Form,
}

impl Forms {
    pub fn of(spec: &Spec, compared: &Compared) -> Self {
        let layout = spec.layout();
        let small = || spec.channels.iter().zip(&layout.fields).filter(|(channel, _)| !channel.is_bulk());
        let channels = |of_action: bool| small().filter(move |(channel, _)| channel.is_of_action() == of_action);
        let rewards: Vec<&str> = compared.rewards().collect();
        let (dtype, _) = spec.actions.numbers();
        let names = spec.actions.names();
        let action = Slot {
            names: names.to_vec(),
            is_list: names.is_empty(),
            ..Slot::new("action", FieldSource::Record(layout.action, false), kind_of(dtype, names))
        };
        let number = |name: &str, place: FieldSource, kind: Type, is_optional: bool| Slot {
            is_optional,
            ..Slot::new(name, place, kind)
        };
        let figures = |prefix: &'static str, place: fn(usize) -> FieldSource, kind, is_optional| {
            let rewards = rewards.iter().enumerate();
            rewards.map(move |(at, name)| number(&format!("{prefix}_{name}"), place(at), kind, is_optional))
        };
        let metrics = spec.metrics.iter().enumerate();
        let metrics = metrics.map(|(at, metric)| number(&metric.name, FieldSource::Metric(at), Type::Double, true));
        let seen = || channels(false).map(|(channel, &field)| of_channel(channel, field, true));
        let acted = channels(true).map(|(channel, &field)| of_channel(channel, field, false));
        let rewarded = figures("reward", FieldSource::Reward, Type::Float, false);
        let returned = figures("return", FieldSource::Return, Type::Double, true);
        let empty = Told {
            record: vec![0; layout.small_bytes],
            rewards: vec![0.0; rewards.len()],
            returns: vec![None; rewards.len()],
            metrics: vec![None; spec.metrics.len()],
            ..Told::default()
        };
        let form = |message, own: &'static str, slots: Vec<Slot>| {
            let mut slots: Vec<Slot> = own.split(' ').map(engine_slot).chain(slots).collect();
            for (number, slot) in (1..).zip(&mut slots) {
                let wire = if slot.is_list { WireType::LengthDelimited } else { slot.wire };
                slot.key = number << 3 | wire as u64;
            }
            let longest = slots.iter().map(Slot::longest).sum();
            Form { message, slots, longest, empty: empty.clone() }
        };
        Self {
            step: form("Step", STEP, std::iter::once(action).chain(rewarded).chain(acted).chain(seen()).collect()),
            start: form("EpisodeStart", START, seen().collect()),
            end: form("EpisodeEnd", END, returned.chain(metrics).collect()),
        }
    }

    pub fn of_topic(&self, topic: &str) -> Option<(Carries, &Form)> {
        match topic {
            "/step" => Some((Carries::Step, &self.step)),
            "/episode/start" => Some((Carries::Start, &self.start)),
            "/episode/end" => Some((Carries::End, &self.end)),
            _ => None,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Carries {
    Step,
    Start,
    End,
}

fn engine_slot(name: &str) -> Slot {
    let at = OWN.iter().position(|own| own.name == name).expect("the engine has what its messages name");
    Slot { is_optional: name == "fixed_episode", ..Slot::new(name, FieldSource::Engine(at), OWN[at].kind) }
}

fn of_channel(channel: &Channel, field: Field, is_seen: bool) -> Slot {
    Slot {
        names: channel.names.clone(),
        is_list: !channel.shape.is_empty(),
        is_optional: is_seen,
        ..Slot::new(&channel.name, FieldSource::Record(field, is_seen), kind_of(channel.dtype, &channel.names))
    }
}

/// Type in messages of a number. One that stands for names has an enumeration, if they can be names there.
fn kind_of(dtype: Dtype, names: &[String]) -> Type {
    let is_name = |name: &String| {
        let mut letters = name.chars();
        let first = letters.next().is_some_and(|first| first.is_ascii_alphabetic() || first == '_');
        first && letters.all(|letter| letter.is_ascii_alphanumeric() || letter == '_')
    };
    let distinct: BTreeSet<&String> = names.iter().collect();
    match dtype {
        _ if !names.is_empty() && names.iter().all(is_name) && distinct.len() == names.len() => Type::Enum,
        Dtype::U8 | Dtype::U16 | Dtype::U32 => Type::Uint32,
        Dtype::I32 => Type::Int32,
        Dtype::U64 => Type::Uint64,
        Dtype::F32 => Type::Float,
        Dtype::F64 => Type::Double,
    }
}

pub fn wire_of(kind: Type) -> WireType {
    match kind {
        Type::Float => WireType::ThirtyTwoBit,
        Type::Double | Type::Fixed64 => WireType::SixtyFourBit,
        _ => WireType::Varint,
    }
}

impl Slot {
    fn new(name: &str, place: FieldSource, kind: Type) -> Self {
        let (name, wire) = (name.to_owned(), wire_of(kind));
        Self { name, place, kind, wire, key: 0, names: vec![], is_list: false, is_optional: false }
    }

    fn longest(&self) -> usize {
        let count = if let FieldSource::Record(field, _) = self.place { field.count } else { 1 };
        20 + 10 * count
    }

    #[inline(always)]
    fn write(&self, told: &Told, out: &mut Cursor<'_>) {
        let bits = match self.place {
            FieldSource::Record(_, true) if !told.seen => return,
            FieldSource::Record(field, _) if self.is_list => return self.write_list(field, &told.record, out),
            FieldSource::Record(field, _) => field.dtype.bits(&told.record[field.offset..]),
            FieldSource::Reward(at) => told.rewards[at].to_bits().into(),
            FieldSource::Engine(at) => match (OWN[at].get)(&told.engine) {
                Some(bits) => bits,
                None => return,
            },
            FieldSource::Return(at) | FieldSource::Metric(at) => {
                let numbers = if matches!(self.place, FieldSource::Return(_)) { &told.returns } else { &told.metrics };
                match numbers[at] {
                    Some(number) => number.to_bits(),
                    None => return,
                }
            }
        };
        if bits != 0 || self.is_optional {
            out.varint(self.key);
            out.number(self.wire, bits);
        }
    }

    fn write_list(&self, field: Field, record: &[u8], out: &mut Cursor<'_>) {
        out.varint(self.key);
        if self.wire == WireType::Varint {
            let length: usize = field.bits(record).map(encoded_len_varint).sum();
            out.varint(length as u64);
            field.bits(record).for_each(|bits| out.varint(bits));
        } else {
            // As they lie in memory.
            let numbers = &record[field.range()];
            out.varint(numbers.len() as u64);
            out.bytes[out.at..out.at + numbers.len()].copy_from_slice(numbers);
            out.at += numbers.len();
        }
    }
}

struct Cursor<'a> {
    bytes: &'a mut [u8],
    at: usize,
}

impl Cursor<'_> {
    #[inline(always)]
    fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.bytes[self.at] = value as u8 | 0x80;
            self.at += 1;
            value >>= 7;
        }
        self.bytes[self.at] = value as u8;
        self.at += 1;
    }

    #[inline(always)]
    fn number(&mut self, wire: WireType, bits: u64) {
        let bytes = bits.to_le_bytes();
        match wire {
            WireType::ThirtyTwoBit => {
                self.bytes[self.at..self.at + 4].copy_from_slice(&bytes[..4]);
                self.at += 4;
            }
            WireType::SixtyFourBit => {
                self.bytes[self.at..self.at + 8].copy_from_slice(&bytes);
                self.at += 8;
            }
            _ => self.varint(bits),
        }
    }
}

impl Form {
    /// Writes the message into `room`, which is as long as any from the first one on.
    pub fn write<'a>(&self, told: &Told, room: &'a mut Vec<u8>) -> &'a [u8] {
        if room.len() < self.longest {
            room.resize(self.longest, 0);
        }
        let mut cursor = Cursor { bytes: room, at: 0 };
        for slot in &self.slots {
            slot.write(told, &mut cursor);
        }
        let end = cursor.at;
        &room[..end]
    }

    pub fn schema(&self) -> Schema {
        let mut message = DescriptorProto { name: Some(self.message.to_owned()), ..DescriptorProto::default() };
        for (number, slot) in (1..).zip(&self.slots) {
            let mut field = FieldDescriptorProto {
                name: Some(slot.name.clone()),
                number: Some(number),
                label: Some(if slot.is_list { Label::Repeated } else { Label::Optional }.into()),
                r#type: Some(slot.kind.into()),
                json_name: Some(slot.name.clone()),
                ..FieldDescriptorProto::default()
            };
            if slot.kind == Type::Enum {
                let named = names_of(slot);
                field.type_name = Some(format!(".{PACKAGE}.{}.{}.Name", self.message, named.name()));
                message.nested_type.push(named);
            }
            if slot.is_optional && !slot.is_list {
                field.oneof_index = Some(message.oneof_decl.len() as i32);
                field.proto3_optional = Some(true);
                let name = Some(format!("_{}", slot.name));
                message.oneof_decl.push(OneofDescriptorProto { name, options: None });
            }
            message.field.push(field);
        }
        let file = FileDescriptorProto {
            name: Some(format!("{PACKAGE}/{}.proto", self.message)),
            package: Some(PACKAGE.to_owned()),
            message_type: vec![message],
            syntax: Some("proto3".to_owned()),
            ..FileDescriptorProto::default()
        };
        let descriptor = FileDescriptorSet { file: vec![file] }.encode_to_vec();
        Schema { name: format!("{PACKAGE}.{}", self.message), descriptor: descriptor.into() }
    }
}

const PACKAGE: &str = "stillroom";

/// The enumeration of a field's names. It lies in a message of its own, because two may have a name in common.
fn names_of(slot: &Slot) -> DescriptorProto {
    let value = |(number, name): (i32, &String)| EnumValueDescriptorProto {
        name: Some(name.clone()),
        number: Some(number),
        options: None,
    };
    let names = EnumDescriptorProto {
        name: Some("Name".to_owned()),
        value: (0..).zip(&slot.names).map(value).collect(),
        ..EnumDescriptorProto::default()
    };
    // Fields begin with a small letter.
    let (first, rest) = slot.name.split_at(1);
    let name = Some(format!("{}{rest}", first.to_ascii_uppercase()));
    DescriptorProto { name, enum_type: vec![names], ..DescriptorProto::default() }
}
