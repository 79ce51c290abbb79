//! What is told of a step beside the observation, and of an episode's start: one row for each environment.

use crate::place::Place;
use numpy::{PyArray1, PyArray2, PyArrayMethods};
use proto::record::End;
use proto::replay::length_m;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use simulator::tasks::arm_point_nav::{Current, RewardParts, Transition};

/// What is told. At an episode's start nothing was done, so what it did is false and 0.
#[derive(Debug, Clone, Copy)]
pub struct Facts {
    state_hash: u64,
    episode: i64,
    step: i64,
    end: Option<End>,
    done: Transition,
    target: i64,
    wrist_object_m: f32,
    object_goal_m: f32,
}

impl Facts {
    /// Of the moment that an environment is in.
    pub fn of(place: &Place, current: &Current) -> Self {
        Self {
            state_hash: place.environment.state_hash(),
            episode: i64::from(place.chosen.number),
            step: place.actions.len() as i64,
            end: place.environment.end(),
            done: place.transition.unwrap_or_default(),
            target: i64::from(current.current_target),
            wrist_object_m: length_m(current.wrist_to_object_m),
            object_goal_m: length_m(current.object_to_goal_m),
        }
    }

    /// How the last action ended the episode, if it did.
    pub fn end(&self) -> Option<End> {
        self.end
    }

    pub fn parts(&self) -> RewardParts {
        self.done.reward
    }
}

/// A dictionary of arrays \[environments\] by name, as `stillroom.types` describes it.
pub fn table<'py>(py: Python<'py>, rows: &[Facts]) -> PyResult<Bound<'py, PyDict>> {
    let table = PyDict::new(py);
    table.set_item("state_hash", column(py, rows, |facts| facts.state_hash))?;
    for (name, figure) in [
        ("episode_number", (|facts| facts.episode) as fn(&Facts) -> i64),
        ("step", |facts| facts.step),
        ("target", |facts| facts.target),
        ("disturbed_objects", |facts| i64::from(facts.done.disturbed_objects)),
        ("ever_disturbed_objects", |facts| i64::from(facts.done.ever_disturbed_objects)),
    ] {
        table.set_item(name, column(py, rows, figure))?;
    }
    for (name, is) in [
        ("success", Transition::succeeded as fn(&Transition) -> bool),
        ("picked_up", Transition::picked_up),
        ("holding", Transition::holds),
        ("action_failed", Transition::failed),
    ] {
        table.set_item(name, column(py, rows, |facts| is(&facts.done)))?;
    }
    for (name, figure) in [
        ("disturbance_m", (|facts| facts.done.disturbance_m) as fn(&Facts) -> f32),
        ("peak_disturbance_m", |facts| facts.done.peak_disturbance_m),
        ("farthest_m", |facts| facts.done.farthest_m),
        ("wrist_object_m", |facts| facts.wrist_object_m),
        ("object_goal_m", |facts| facts.object_goal_m),
    ] {
        table.set_item(name, column(py, rows, figure))?;
    }
    let parts = PyDict::new(py);
    for (name, part) in [
        ("wrist_object_progress_m", (|parts| parts.wrist_object_progress_m) as fn(&RewardParts) -> f32),
        ("object_goal_progress_m", |parts| parts.object_goal_progress_m),
        ("disturbance_progress_m", |parts| parts.disturbance_progress_m),
        ("failed_action", |parts| parts.failed_action),
        ("picked_up", |parts| parts.picked_up),
        ("goal_success", |parts| parts.goal_success),
    ] {
        parts.set_item(name, column(py, rows, |facts| part(&facts.done.reward)))?;
    }
    table.set_item("reward_parts", parts)?;
    Ok(table)
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
