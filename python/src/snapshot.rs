//! A moment to which an environment can return, in memory or as bytes.
//!
//! In memory it is a copy of everything, physics included. As bytes it is the episode and its actions: reading it
//! simulates them again, which takes as long as physics took the first time and gives the same bits; the state's hash is
//! compared.

use crate::episode_player::{Chosen, EpisodePlayer};
use crate::error::value_error;
use crate::room::{Origin, Room};
use proto::config::{CarriedGoal, Config, EpisodeConfig, NetworkConfig, SimulationConfig};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;
use pyo3::types::{PyBytes, PyTuple};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

const VERSION: u32 = 1;

/// A moment of one environment.
#[pyclass(frozen, module = "stillroom._stillroom")]
pub struct Snapshot {
    /// Everything about it.
    pub place: EpisodePlayer,
}

#[derive(Serialize, Deserialize)]
struct Record {
    version: u32,
    #[serde(default = "first_task")]
    task: String,
    #[serde(default = "first_goal")]
    carried_goal: CarriedGoal,
    origin: Origin,
    environment: u32,
    episode: EpisodeConfig,
    simulation: SimulationConfig,
    chosen: Chosen,
    actions: Vec<u8>,
    state_hash: u64,
}

/// Of snapshots without one.
fn first_task() -> String {
    Config::default().task
}

fn first_goal() -> CarriedGoal {
    Config::default().network.carried_goal
}

#[pymethods]
impl Snapshot {
    #[getter]
    fn state_hash(&self) -> u64 {
        self.place.base().state_hash()
    }

    /// Actions taken in the episode so far.
    #[getter]
    fn step(&self) -> usize {
        self.place.actions.len()
    }

    /// The episode and its actions, to be kept in a file.
    fn to_bytes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let place = &self.place;
        let record = Record {
            version: VERSION,
            task: place.config.task.clone(),
            carried_goal: place.config.network.carried_goal,
            origin: place.room.origin.clone(),
            environment: place.id.number,
            episode: place.config.episode,
            simulation: place.config.simulation,
            chosen: place.chosen,
            actions: place.actions.clone(),
            state_hash: self.state_hash(),
        };
        Ok(PyBytes::new(py, &serde_json::to_vec(&record).map_err(value_error)?))
    }

    /// Simulates again what `to_bytes` returned.
    #[staticmethod]
    fn from_bytes(py: Python<'_>, bytes: &Bound<'_, PyAny>) -> PyResult<Self> {
        let bytes: PyBackedBytes =
            bytes.extract().map_err(|_| PyTypeError::new_err("a snapshot is read from bytes"))?;
        let record: Record = serde_json::from_slice(&bytes)
            .map_err(|error| PyValueError::new_err(format!("these bytes are no snapshot: {error}")))?;
        py.detach(|| again(record))
    }

    /// It never changes.
    fn __deepcopy__(slf: Py<Self>, _memo: &Bound<'_, PyAny>) -> Py<Self> {
        slf
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyTuple>> {
        let py = slf.py();
        let arguments = PyTuple::new(py, [slf.get().to_bytes(py)?])?;
        PyTuple::new(py, [slf.get_type().getattr("from_bytes")?, arguments.into_any()])
    }
}

/// The moment that a record describes.
fn again(record: Record) -> PyResult<Snapshot> {
    if record.version != VERSION {
        let found = record.version;
        return Err(PyValueError::new_err(format!("the snapshot is of version {found}, not {VERSION}")));
    }
    let Record { task, episode, simulation, carried_goal, .. } = record;
    let network = NetworkConfig { carried_goal, ..Default::default() };
    let config = Config { task, episode, simulation, network, ..Default::default() };
    config.validate().map_err(value_error)?;
    let space = config.policy_actions();
    let room = Room::of(record.origin, config.simulation)?;
    let mut place =
        EpisodePlayer::new(room, Arc::new(config), record.environment, record.chosen).map_err(value_error)?;
    for action in record.actions {
        if !space.contains(&action) || place.ended() {
            return Err(PyValueError::new_err("the snapshot's actions are no episode"));
        }
        place.step(action);
    }
    if place.base().state_hash() != record.state_hash {
        return Err(PyValueError::new_err(
            "simulated again, the snapshot leads to another state: it is damaged, its scene has changed, or it was \
             written by another version of stillroom",
        ));
    }
    Ok(Snapshot { place })
}
