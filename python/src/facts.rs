//! What is told of a step beside the observation, and of an episode's start: one row for each environment. Names and types
//! are the task's.

use crate::episode_player::EpisodePlayer;
use numpy::PyArray1;
use proto::record::End;
use proto::task::{Channel, Dtype, Field, Kind, Measure, Role, Spec};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Keys that users have known longer than the channels.
const CALLED: [(&str, &str); 3] =
    [("held", "holding"), ("failed_action", "action_failed"), ("current_target", "target")];

/// What a channel is called in Python.
pub fn called(channel: &Channel) -> &str {
    CALLED.iter().find(|(name, _)| *name == channel.name).map_or(&channel.name, |(_, called)| called)
}

/// What is told. At an episode's start nothing was done, so what it did is false and 0 but where the task says otherwise.
#[derive(Debug, Clone)]
pub struct Facts {
    state_hash: u64,
    episode: i64,
    step: i64,
    end: Option<End>,
    /// The task's bytes, as a learner is told them.
    pub record: Vec<u8>,
}

impl Facts {
    /// Of the moment that an environment is in.
    pub fn of(place: &EpisodePlayer) -> Self {
        Self {
            state_hash: place.base().state_hash(),
            episode: i64::from(place.chosen.number),
            step: place.actions.len() as i64,
            end: place.base().end(),
            record: place.record.clone(),
        }
    }

    /// How the last action ended the episode, if it did.
    pub fn end(&self) -> Option<End> {
        self.end
    }

    /// A part of the reward by the index of its channel.
    pub fn part(&self, task: &Spec, index: usize) -> f32 {
        task.layout().part(&self.record, index)
    }
}

/// A dictionary of arrays \[environments\] by name, as `stillroom.types` describes it: what an action led to, parts of
/// rewards, and of each share among the metrics whether it is so after this step.
pub fn table<'py>(py: Python<'py>, task: &Spec, rows: &[Facts]) -> PyResult<Bound<'py, PyDict>> {
    let (table, parts) = (PyDict::new(py), PyDict::new(py));
    table.set_item("state_hash", column(py, rows, |facts| facts.state_hash))?;
    table.set_item("episode_number", column(py, rows, |facts| facts.episode))?;
    table.set_item("step", column(py, rows, |facts| facts.step))?;
    for (channel, &field) in task.channels.iter().zip(&task.layout().fields) {
        match channel.role {
            Role::Part => {
                parts.set_item(&channel.name, column(py, rows, |facts| field.f32(&facts.record)))?;
                if called(channel) != channel.name {
                    table.set_item(called(channel), column(py, rows, |facts| field.number(&facts.record) != 0.0))?;
                }
            }
            Role::Outcome if channel.shape.is_empty() => put(py, &table, channel, field, rows)?,
            Role::Outcome | Role::Observation | Role::Privileged | Role::Mask | Role::State => {}
        }
    }
    for (metric, measure) in task.rollout_metrics().filter(|(_, measure)| measure.kind() == Kind::Share) {
        table.set_item(&metric.name, column(py, rows, |facts| holds(&measure, task, facts)))?;
    }
    table.set_item("reward_parts", parts)?;
    Ok(table)
}

/// Whether a share's clauses hold after a step.
fn holds(measure: &Measure, task: &Spec, facts: &Facts) -> bool {
    measure.after(|index| task.layout().fields[index].number(&facts.record), 0.0) != 0.0
}

/// A channel's numbers by their type in Python.
fn put(py: Python<'_>, table: &Bound<'_, PyDict>, channel: &Channel, field: Field, rows: &[Facts]) -> PyResult<()> {
    let (name, number) = (called(channel), |facts: &Facts| field.number(&facts.record));
    match channel.dtype {
        _ if channel.values == [0.0, 1.0] => table.set_item(name, column(py, rows, |facts| number(facts) != 0.0)),
        Dtype::F32 => table.set_item(name, column(py, rows, |facts| field.f32(&facts.record))),
        Dtype::F64 => table.set_item(name, column(py, rows, number)),
        Dtype::U8 | Dtype::U16 | Dtype::I32 | Dtype::U32 | Dtype::U64 => {
            table.set_item(name, column(py, rows, |facts| number(facts) as i64))
        }
    }
}

/// One figure of each row.
pub fn column<'py, T: numpy::Element, R>(
    py: Python<'py>,
    rows: &[R],
    figure: impl Fn(&R) -> T,
) -> Bound<'py, PyArray1<T>> {
    PyArray1::from_iter(py, rows.iter().map(figure))
}
