//! The check of a record on arrival.
//!
//! Records come from another process through shared memory. One that is faulty, or not ours, can write anything there. A
//! number that the task does not declare must not be trained on, and not be recorded as a fact. Each number but those of
//! images is compared with its range at each step.

use super::channel::{Channel, Dtype, Role};
use super::layout::{Field, HEADER_BYTES};
use super::spec::Spec;
use crate::record::{End, RecordHeader};
use std::ops::Range;

#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Implausible {
    #[error("its {0} is not finite")]
    NotFinite(String),
    #[error("its {what} is {value}, which cannot be: {allowed}")]
    Range { what: String, value: f64, allowed: String },
    #[error("its {0} allows no option of a choice: one at least can always be chosen")]
    NoOption(String),
}

#[derive(Debug, Clone, PartialEq)]
enum Sound {
    /// Written so that NaN is refused, too.
    Range([f64; 2]),
    Values(Vec<f64>),
}

impl Sound {
    /// Whether all numbers of a field are sound, where that is seen at once: there may be thousands. False says nothing.
    fn holds_for_all(&self, field: Field, record: &[u8]) -> bool {
        let (Self::Range([least, most]), Dtype::F32) = (self, field.dtype) else { return false };
        let numbers: &[f32] = bytemuck::try_cast_slice(&record[field.range()]).unwrap_or_default();
        let is_sound = |&number: &f32| (*least <= f64::from(number)) & (f64::from(number) <= *most);
        !numbers.is_empty() && numbers.iter().fold(true, |all, number| all & is_sound(number))
    }

    fn allowed(&self) -> String {
        match self {
            Self::Range([least, most]) => format!("its range is {least} to {most}"),
            Self::Values(values) => {
                format!("its values are {}", values.iter().map(f64::to_string).collect::<Vec<_>>().join(", "))
            }
        }
    }
}

/// A channel, as messages name it.
#[derive(Debug, Clone)]
struct What {
    name: String,
    shape: Vec<usize>,
}

impl What {
    fn of(channel: &Channel) -> Self {
        Self { name: channel.name.clone(), shape: channel.shape.clone() }
    }

    /// The same as it was seen last of an episode.
    fn last(&self) -> Self {
        Self { name: format!("last {}", self.name), ..self.clone() }
    }

    /// One of its numbers: `goal_m[2]`.
    fn at(&self, mut index: usize) -> String {
        let mut places: Vec<String> = vec![];
        for size in self.shape.iter().rev() {
            places.insert(0, (index % size).to_string());
            index /= size;
        }
        let places = places.join(", ");
        if places.is_empty() { self.name.clone() } else { format!("{}[{places}]", self.name) }
    }
}

#[derive(Debug, Clone)]
struct Mask {
    field: Field,
    /// Options of each choice.
    choices: Vec<usize>,
    what: String,
}

#[derive(Debug, Clone)]
pub struct Check {
    of_action: Vec<(Field, Sound, What)>,
    seen: Vec<(Field, Sound, What)>,
    /// Of a truncated episode.
    last_seen: Vec<(Field, Sound, What)>,
    /// All of that, 0 of any other record.
    last_bytes: Range<usize>,
    mask: Option<Mask>,
    /// Bytes that no channel has, always 0.
    gaps: Vec<Range<usize>>,
}

impl Check {
    pub fn of(spec: &Spec) -> Self {
        let checks = |of_action: bool| -> Vec<(Field, Sound, What)> {
            let pairs = spec.channels.iter().zip(&spec.layout().fields);
            pairs
                .filter(|(channel, _)| channel.is_of_action() == of_action && !channel.is_bulk())
                .filter_map(|(channel, &field)| Some((field, sound(channel)?, What::of(channel))))
                .collect()
        };
        let mut gaps = vec![];
        let layout = spec.layout();
        let mut end = HEADER_BYTES;
        let mut fields: Vec<Field> = [layout.action, layout.previous_action].to_vec();
        fields.extend(layout.fields.iter().filter(|field| field.offset < layout.small_bytes));
        let is_seen = |field: &Field| layout.seen.contains(&field.offset);
        fields.extend(layout.fields.iter().copied().filter(is_seen).filter_map(|field| layout.last(field)));
        let snapshot = Field { offset: layout.snapshot.start, dtype: Dtype::U8, count: layout.snapshot.len() };
        fields.extend((snapshot.count > 0).then_some(snapshot));
        fields.sort_by_key(|field| field.offset);
        for field in fields {
            gaps.push(end..field.offset);
            end = field.range().end;
        }
        gaps.push(end..layout.small_bytes);
        gaps.retain(|gap| !gap.is_empty());
        let seen = checks(false);
        let again =
            seen.iter().filter_map(|(field, sound, what)| Some((layout.last(*field)?, sound.clone(), what.last())));
        let (last_seen, last_bytes) = (again.collect(), layout.last_seen.clone());
        let pairs = spec.channels.iter().zip(&layout.fields);
        let mut masks = pairs.filter(|(channel, _)| channel.role == Role::Mask);
        let mask = masks.next().map(|(channel, &field)| Mask {
            field,
            choices: spec.actions.choices(),
            what: channel.name.clone(),
        });
        Self { of_action: checks(true), seen, last_seen, last_bytes, mask, gaps }
    }

    /// Refuses a record after which no action could be chosen. The last record of an episode may allow nothing, because
    /// no action follows. Panics as [`Self::record`] does.
    pub fn choice(&self, record: &[u8]) -> Result<(), Implausible> {
        let Some(Mask { field, choices, what }) = &self.mask else { return Ok(()) };
        let mut rest = &record[field.range()];
        let mut own = choices.iter().map(|&options| rest.split_off(..options).unwrap_or_default());
        if own.all(|options| options.contains(&1)) { Ok(()) } else { Err(Implausible::NoOption(what.clone())) }
    }

    /// Checks a record. `acted`: an action was taken, so that what it did counts. Panics if the record is shorter than
    /// [`super::Layout::small_bytes`].
    pub fn record(&self, record: &[u8], acted: bool) -> Result<(), Implausible> {
        let of_action = if acted { &self.of_action[..] } else { &[] };
        let header: RecordHeader = bytemuck::pod_read_unaligned(&record[..HEADER_BYTES]);
        let truncated = header.end() == Some(End::Truncated);
        let last_seen = if truncated { &self.last_seen[..] } else { &[] };
        for (field, sound, what) in self.seen.iter().chain(of_action).chain(last_seen) {
            if sound.holds_for_all(*field, record) {
                continue;
            }
            for (index, value) in field.numbers(record).enumerate() {
                let is_sound = match sound {
                    Sound::Range([least, most]) => (*least..=*most).contains(&value),
                    Sound::Values(values) => values.contains(&value),
                };
                if !is_sound {
                    let what = what.at(index);
                    return Err(if value.is_finite() {
                        Implausible::Range { what, value, allowed: sound.allowed() }
                    } else {
                        Implausible::NotFinite(what)
                    });
                }
            }
        }
        let unused = (!truncated).then_some(&self.last_bytes);
        let gaps = self.gaps.iter().chain(unused).map(|gap| &record[gap.clone()]);
        // There may be thousands of bytes: an OR of them takes many at a time, a search one by one.
        let mut strange = gaps.filter(|gap| gap.iter().fold(0, |all, byte| all | byte) != 0).flatten();
        let byte = strange.find(|&&byte| byte != 0);
        byte.map_or(Ok(()), |&byte| {
            let (what, allowed) = ("reserved byte".to_owned(), "it is 0".to_owned());
            Err(Implausible::Range { what, value: byte.into(), allowed })
        })
    }
}

fn sound(channel: &Channel) -> Option<Sound> {
    if channel.values.is_empty() {
        channel.bounds().map(Sound::Range)
    } else {
        Some(Sound::Values(channel.values.clone()))
    }
}
