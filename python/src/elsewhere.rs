//! An environment whose things another physics engine moves: what that engine is told, and what it tells. Poses are
//! written as `MuJoCo` does: position, then the quaternion with its real part first.

use crate::episode_player::EpisodePlayer;
use crate::error::value_error;
use numpy::{PyArray1, PyArray3, PyArrayMethods, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use rapier3d::math::{Pose3, Rot3, Vec3};
use simulator::robot::links::PART_COUNT;

/// Poses of the robot's parts \[sub-steps, parts, 7\], and whether the action succeeds if nothing stops the robot.
pub type Told<'py> = (Bound<'py, PyArray3<f64>>, bool);

const POSE: usize = 7;

/// Where an action takes the robot of the only environment.
pub fn way<'py>(py: Python<'py>, places: &mut [EpisodePlayer], actions: &[u8]) -> PyResult<Told<'py>> {
    let ([place], [action]) = (places, actions) else {
        return Err(PyValueError::new_err("another engine moves the things of one environment"));
    };
    let refusal = || PyValueError::new_err("another engine moves the things of arm_point_nav alone");
    let way = place.way(*action).ok_or_else(refusal)?;
    let numbers: Vec<f64> = way.parts.iter().flatten().flat_map(numbers).collect();
    let poses = PyArray1::from_vec(py, numbers).reshape([way.parts.len(), PART_COUNT, POSE])?;
    Ok((poses, way.arrives))
}

/// Where the engine has moved the things of the only environment.
pub fn poses(places: &[EpisodePlayer], poses: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<Pose3>> {
    let things = places[0].base().simulation().movable_count();
    let rows = poses.as_slice().map_err(value_error)?;
    if rows.len() != things * POSE || !rows.iter().all(|number| number.is_finite()) {
        return Err(PyValueError::new_err(format!("poses are {POSE} finite numbers for each of {things} things")));
    }
    Ok(rows.as_chunks().0.iter().map(pose).collect())
}

fn numbers(pose: &Pose3) -> [f64; POSE] {
    let (t, r) = (pose.translation, pose.rotation);
    [t.x, t.y, t.z, r.w, r.x, r.y, r.z].map(f64::from)
}

fn pose(numbers: &[f64; POSE]) -> Pose3 {
    let [x, y, z, w, i, j, k] = numbers.map(|number| number as f32);
    Pose3::from_parts(Vec3::new(x, y, z), Rot3::from_xyzw(i, j, k, w))
}
