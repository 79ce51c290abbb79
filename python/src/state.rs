//! Everything about a moment, for users who may know it: planners, critics, figures.

use crate::episode_player::EpisodePlayer;
use numpy::{PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// The privileged state, as `stillroom.types.State` describes it.
pub fn state<'py>(py: Python<'py>, place: &EpisodePlayer) -> PyResult<Bound<'py, PyDict>> {
    let (environment, current) = (&place.environment, place.environment.current());
    let simulation = environment.simulation();
    let poses = simulation.things().poses();
    let state = PyDict::new(py);
    state.set_item("kitchen", place.room.kitchen.id().number())?;
    state.set_item("seed", place.chosen.seed)?;
    state.set_item("episode", place.chosen.number)?;
    state.set_item("step", place.actions.len())?;
    state.set_item("state_hash", environment.state_hash())?;
    state.set_item("target", environment.episode().category.name())?;
    state.set_item("target_object", place.room.kitchen.target_movable(environment.episode().category))?;
    state.set_item("holding", simulation.holding())?;
    state.set_item("base_yaw_rad", current.base_yaw_rad)?;
    state.set_item("camera_pitch_rad", current.camera_pitch_rad)?;
    for (name, vector) in [
        ("base_position_m", current.base_position_m.as_slice()),
        ("wrist_position_m", &current.wrist_position_m),
        ("target_position_m", &current.target_position_m),
        ("goal_position_m", &current.goal_position_m),
        ("wrist_to_object_m", &current.wrist_to_object_m),
        ("object_to_goal_m", &current.object_to_goal_m),
    ] {
        state.set_item(name, PyArray1::from_slice(py, vector))?;
    }
    let robot = environment.robot();
    let [x, y, z] = robot.wrist_ticks;
    let ticks = [robot.height_ticks, x, y, z, robot.elbow_ticks, robot.wrist_yaw_ticks, robot.wrist_pitch_ticks];
    state.set_item("arm_ticks", PyArray1::from_slice(py, &ticks))?;
    let camera = environment.world_from_camera();
    state.set_item("camera_position_m", PyArray1::from_slice(py, &camera.translation.to_array()))?;
    state.set_item("camera_rotation_xyzw", PyArray1::from_slice(py, &camera.rotation.to_array()))?;
    let rows: Vec<f32> = poses.iter().flat_map(|pose| pose.translation.to_array()).collect();
    state.set_item("object_positions_m", shaped(py, &rows, 3)?)?;
    let rows: Vec<f32> = poses.iter().flat_map(|pose| pose.rotation.to_array()).collect();
    state.set_item("object_rotations_xyzw", shaped(py, &rows, 4)?)?;
    state.set_item("object_displacements_m", PyArray1::from_iter(py, environment.displacements_m()))?;
    Ok(state)
}

fn shaped<'py>(py: Python<'py>, numbers: &[f32], columns: usize) -> PyResult<Bound<'py, PyArray2<f32>>> {
    PyArray1::from_slice(py, numbers).reshape([numbers.len() / columns, columns])
}
