//! What data sets hold of every moment beside pictures: one table from which arrays and page follow.

use crate::episode::{Episode, Moment};
use crate::page::Source;
use proto::record::End;
use proto::task::{Channel, Dtype, Field, Role};

/// An array with a row for each action, or for each moment.
pub struct Column<'a> {
    pub name: String,
    pub about: String,
    /// `NumPy`'s name of its type.
    pub kind: &'static str,
    /// Of one row.
    pub shape: Vec<usize>,
    /// It has a row before each action and one after the last; otherwise one an action, of the moment after it.
    pub is_seen: bool,
    of: Of<'a>,
}

enum Of<'a> {
    /// A channel; whether it is yes or no.
    Channel(&'a Field, bool),
    StateHash,
    /// The action of a moment's record, and the one before, as numbers of the run's.
    Action(Field),
    Previous(Field),
    /// The same, of actions that are numbers themselves.
    Numbers(Field),
    Reward(usize),
    Terminated,
    Truncated,
    Ended,
}

impl Source {
    /// The arrays of an episode, in their order: what is seen, then what actions do.
    pub fn columns(&self) -> Vec<Column<'_>> {
        let layout = self.spec.layout();
        let column = |name: &str, about: &str, kind, is_seen, of| Column {
            name: name.to_owned(),
            about: about.to_owned(),
            kind,
            shape: vec![],
            is_seen,
            of,
        };
        let channels = |seen: bool| {
            let pairs = self.spec.channels.iter().zip(&layout.fields);
            pairs.filter(move |(channel, _)| !channel.is_bulk() && channel.is_of_action() != seen)
        };
        let named = !self.spec.actions.names().is_empty();
        let action = |name: &str, about: &str, is_seen, field: Field, of: fn(Field) -> Of<'static>| Column {
            shape: if named { vec![] } else { vec![field.count] },
            kind: if named { "<i8" } else { numpy_type(field.dtype) },
            ..column(name, about, "", is_seen, if named { of(field) } else { Of::Numbers(field) })
        };
        let mut columns: Vec<Column> = channels(true).map(|(channel, field)| of_channel(channel, field)).collect();
        columns.push(column("state_hash", "Hash of the simulator's state.", "<u8", true, Of::StateHash));
        let before = if named {
            "The action before; at the start the number of actions there are."
        } else {
            "The action before; 0 at the start."
        };
        columns.push(action("previous_action", before, true, layout.previous_action, Of::Previous));
        columns.push(action("action", "The action.", false, layout.action, Of::Action));
        for (at, name) in self.rewards.iter().enumerate() {
            let about = format!("The reward {name}.");
            columns.push(column(&format!("reward_{name}"), &about, "<f4", false, Of::Reward(at)));
        }
        columns.extend(channels(false).map(|(channel, field)| of_channel(channel, field)));
        columns.push(column("terminated", "The task ended the episode.", "|b1", false, Of::Terminated));
        columns.push(column("truncated", "The limit of steps ended it.", "|b1", false, Of::Truncated));
        columns.push(column("ended", "Either of both.", "|b1", false, Of::Ended));
        columns
    }

    /// Channels that the policy may be given, but images.
    pub fn observations(&self) -> Vec<&str> {
        let observed = |channel: &&Channel| channel.role == Role::Observation && !channel.is_bulk();
        self.spec.channels.iter().filter(observed).map(|channel| channel.name.as_str()).collect()
    }
}

fn of_channel<'a>(channel: &Channel, field: &'a Field) -> Column<'a> {
    let is_bool = channel.values == [0.0, 1.0];
    let kind = if is_bool { "|b1" } else { numpy_type(channel.dtype) };
    Column {
        name: channel.name.clone(),
        about: channel.doc.clone(),
        kind,
        shape: channel.shape.clone(),
        is_seen: !channel.is_of_action(),
        of: Of::Channel(field, is_bool),
    }
}

fn numpy_type(dtype: Dtype) -> &'static str {
    match dtype {
        Dtype::U8 => "|u1",
        Dtype::U16 => "<u2",
        Dtype::I32 => "<i4",
        Dtype::U32 => "<u4",
        Dtype::U64 => "<u8",
        Dtype::F32 => "<f4",
        Dtype::F64 => "<f8",
    }
}

impl Column<'_> {
    pub fn rows<'e>(&self, episode: &'e Episode) -> &'e [Moment] {
        &episode.moments[usize::from(!self.is_seen)..]
    }

    /// The bytes of a row. `numbers`: for each of the task's actions its number among the run's.
    pub fn append(&self, moment: &Moment, is_start: bool, numbers: &[Option<u32>], out: &mut Vec<u8>) {
        let number = |field: Field| {
            let own = numbers.get(field.number(&moment.record) as usize).copied().flatten();
            // Its simulation has refused actions that are none of the run's.
            i64::from(own.unwrap_or(u32::MAX))
        };
        match self.of {
            Of::Channel(field, true) => out.extend(field.numbers(&moment.record).map(|number| u8::from(number != 0.0))),
            Of::Channel(field, false) => out.extend_from_slice(&moment.record[field.range()]),
            Of::StateHash => out.extend(moment.state_hash.to_le_bytes()),
            Of::Previous(_) if is_start => {
                let count = numbers.iter().flatten().count() as i64;
                out.extend(count.to_le_bytes());
            }
            Of::Action(field) | Of::Previous(field) => out.extend(number(field).to_le_bytes()),
            Of::Numbers(field) => out.extend_from_slice(&moment.record[field.range()]),
            Of::Reward(at) => out.extend(moment.rewards[at].to_le_bytes()),
            Of::Terminated => out.push(u8::from(moment.end == Some(End::Terminated))),
            Of::Truncated => out.push(u8::from(moment.end == Some(End::Truncated))),
            Of::Ended => out.push(u8::from(moment.end.is_some())),
        }
    }
}
