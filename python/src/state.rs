//! Everything about a moment, for users who may know it: planners, critics, figures.

use crate::episode_player::EpisodePlayer;
use crate::facts::called;
use numpy::{PyArray1, PyArray2, PyArrayMethods};
use proto::task::Role;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// The privileged state, of which `stillroom.types.State` says more.
pub fn state<'py>(py: Python<'py>, place: &EpisodePlayer) -> PyResult<Bound<'py, PyDict>> {
    let (base, spec) = (place.base(), place.config.spec());
    let (simulation, kitchen) = (base.simulation(), &place.room.kitchen);
    let poses = simulation.things().poses();
    let state = PyDict::new(py);
    state.set_item("kitchen", kitchen.id().number())?;
    state.set_item("seed", place.chosen.seed)?;
    state.set_item("episode", place.chosen.number)?;
    state.set_item("step", place.actions.len())?;
    state.set_item("state_hash", base.state_hash())?;
    if let Some(target) = picture::target(spec, base, &place.record) {
        state.set_item("target_object", target)?;
    }
    let fields = spec.channels.iter().zip(&spec.layout().fields);
    for (channel, field) in fields.filter(|(channel, _)| matches!(channel.role, Role::State | Role::Privileged)) {
        let (name, number) = (called(channel), field.number(&place.record));
        if !channel.shape.is_empty() {
            state.set_item(name, PyArray1::from_iter(py, field.numbers(&place.record).map(|number| number as f32)))?;
        } else if let Some(meant) = channel.names.get(number as usize) {
            state.set_item(name, meant)?;
        } else if channel.values == [0.0, 1.0] {
            state.set_item(name, number != 0.0)?;
        } else {
            state.set_item(name, number)?;
        }
    }
    let robot = base.robot();
    let [x, y, z] = robot.wrist_ticks;
    let ticks = [robot.height_ticks, x, y, z, robot.elbow_ticks, robot.wrist_yaw_ticks, robot.wrist_pitch_ticks];
    state.set_item("arm_ticks", PyArray1::from_slice(py, &ticks))?;
    let camera = base.world_from_camera();
    state.set_item("camera_position_m", PyArray1::from_slice(py, &camera.translation.to_array()))?;
    state.set_item("camera_rotation_xyzw", PyArray1::from_slice(py, &camera.rotation.to_array()))?;
    let rows: Vec<f32> = poses.iter().flat_map(|pose| pose.translation.to_array()).collect();
    state.set_item("object_positions_m", shaped(py, &rows, 3)?)?;
    let rows: Vec<f32> = poses.iter().flat_map(|pose| pose.rotation.to_array()).collect();
    state.set_item("object_rotations_xyzw", shaped(py, &rows, 4)?)?;
    state.set_item("object_displacements_m", PyArray1::from_iter(py, base.displacements_m()))?;
    Ok(state)
}

fn shaped<'py>(py: Python<'py>, numbers: &[f32], columns: usize) -> PyResult<Bound<'py, PyArray2<f32>>> {
    PyArray1::from_slice(py, numbers).reshape([numbers.len() / columns, columns])
}
