//! What is told of a step beside the observation, and of an episode's start: one row for each environment. Names and types
//! are the task's.

use crate::episode_player::EpisodePlayer;
use numpy::{PyArray1, PyArray2, PyArrayMethods};
use proto::record::End;
use proto::task::{Channel, Dtype, Field, Measure, Role, Spec};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use simulator::tasks::arm_point_nav::{self, Current};

/// Keys that users have known longer than the channels.
const CALLED: [(&str, &str); 2] = [("held", "holding"), ("failed_action", "action_failed")];

/// What is told. At an episode's start nothing was done, so what it did is false and 0.
#[derive(Debug, Clone)]
pub struct Facts {
    state_hash: u64,
    episode: i64,
    step: i64,
    end: Option<End>,
    /// The task's bytes, as a learner is told them.
    record: Vec<u8>,
}

impl Facts {
    /// Of the moment that an environment is in.
    pub fn of(place: &EpisodePlayer, current: &Current) -> Self {
        let mut done = place.transition.unwrap_or_default();
        // Known at an episode's start, too.
        done.target = current.current_target;
        let length = |[x, y, z]: [f32; 3]| (x * x + y * y + z * z).sqrt();
        done.wrist_object_m = length(current.wrist_to_object_m);
        done.object_goal_m = length(current.object_to_goal_m);
        let mut record = vec![0; place.config.spec().layout().small_bytes];
        arm_point_nav::write(&mut record, &done, current);
        Self {
            state_hash: place.environment.state_hash(),
            episode: i64::from(place.chosen.number),
            step: place.actions.len() as i64,
            end: place.environment.end(),
            record,
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
        let called = CALLED.iter().find(|(name, _)| *name == channel.name).map(|(_, called)| *called);
        match channel.role {
            Role::Part => {
                parts.set_item(&channel.name, column(py, rows, |facts| field.f32(&facts.record)))?;
                if let Some(called) = called {
                    table.set_item(called, column(py, rows, |facts| field.number(&facts.record) != 0.0))?;
                }
            }
            Role::Outcome if channel.shape.is_empty() => {
                put(py, &table, called.unwrap_or(&channel.name), channel, field, rows)?;
            }
            Role::Outcome | Role::Observation | Role::State => {}
        }
    }
    for (metric, measure) in task.metrics.iter().zip(task.measures()) {
        if metric.curve && metric.is_share() {
            table.set_item(&metric.name, column(py, rows, |facts| holds(&measure, task, facts)))?;
        }
    }
    table.set_item("reward_parts", parts)?;
    Ok(table)
}

/// Whether a share's clauses hold after a step.
fn holds(measure: &Measure, task: &Spec, facts: &Facts) -> bool {
    measure.after(|index| task.layout().fields[index].number(&facts.record), 0.0) != 0.0
}

/// A channel's numbers by their type in Python.
fn put(
    py: Python<'_>,
    table: &Bound<'_, PyDict>,
    name: &str,
    channel: &Channel,
    field: Field,
    rows: &[Facts],
) -> PyResult<()> {
    let number = |facts: &Facts| field.number(&facts.record);
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

/// Rows of three numbers into an array that stays where it is.
pub fn put_vectors(array: &Bound<'_, PyArray2<f32>>, rows: &[[f32; 3]]) -> PyResult<()> {
    array.try_readwrite()?.as_slice_mut()?.copy_from_slice(rows.as_flattened());
    Ok(())
}
