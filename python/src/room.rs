//! A kitchen that environments share: built once while somebody uses it.

use crate::argument::{self, whole};
use crate::error::value_error;
use proto::config::SimulationConfig;
use proto::kitchen::KitchenId;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyTuple;
use serde::{Deserialize, Serialize};
use simulator::mjcf;
use simulator::scene_file;
use simulator::tasks::arm_point_nav::episode::Episode;
use simulator::tasks::arm_point_nav::episodes::{self, EpisodesError};
use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, OnceLock, PoisonError, Weak};

#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Origin {
    BuiltIn(u32),
    /// A user's scene, and its place in the list of a run's scenes.
    Scene {
        path: PathBuf,
        index: usize,
    },
}

/// A kitchen, where it comes from, and its fixed episodes.
#[derive(Debug)]
pub struct Room {
    pub kitchen: Arc<simulator::kitchen::Kitchen>,
    pub origin: Origin,
    fixed: OnceLock<Result<Vec<Episode>, EpisodesError>>,
}

/// What tells kitchens apart: origin, and how their physics steps (the time of a sub-step as bits, and how many).
type Identity = (Origin, u32, u32);

impl Room {
    /// The kitchen of this origin: the one that is in use, or built anew.
    pub fn of(origin: Origin, simulation: SimulationConfig) -> PyResult<Arc<Self>> {
        static IN_USE: Mutex<Option<HashMap<Identity, Weak<Room>>>> = Mutex::new(None);
        let identity = (origin.clone(), simulation.timestep_s.to_bits(), simulation.substeps);
        // A scene may have been edited since: it is read again.
        let shared = matches!(origin, Origin::BuiltIn(_));
        if shared {
            let in_use = IN_USE.lock().unwrap_or_else(PoisonError::into_inner);
            if let Some(room) = in_use.as_ref().and_then(|rooms| rooms.get(&identity)).and_then(Weak::upgrade) {
                return Ok(room);
            }
        }
        let room = Arc::new(Self::build(origin, simulation)?);
        if shared {
            let mut in_use = IN_USE.lock().unwrap_or_else(PoisonError::into_inner);
            in_use.get_or_insert_default().insert(identity, Arc::downgrade(&room));
        }
        Ok(room)
    }

    fn build(origin: Origin, simulation: SimulationConfig) -> PyResult<Self> {
        let kitchen = match &origin {
            Origin::BuiltIn(number) => {
                let id = KitchenId::generated(*number).map_err(value_error)?;
                simulator::kitchen::Kitchen::build(id, &simulation).map_err(value_error)?
            }
            Origin::Scene { path, index } => {
                let id = KitchenId::scene(*index);
                let id = id.ok_or_else(|| PyValueError::new_err("there are more than 128 scenes"))?;
                scene_file::load(path, id, &simulation).map_err(value_error)?
            }
        };
        Ok(Self { kitchen: Arc::new(kitchen), origin, fixed: OnceLock::new() })
    }

    pub fn fixed(&self) -> Result<&[Episode], EpisodesError> {
        self.fixed.get_or_init(|| episodes::fixed(&self.kitchen)).as_deref().map_err(Clone::clone)
    }
}

/// A kitchen, built or read. Environments in the same one share it.
#[pyclass(frozen, from_py_object, module = "stillroom._stillroom")]
#[derive(Debug, Clone)]
pub struct Kitchen {
    pub room: Arc<Room>,
}

/// The same error, with what to give.
fn explained(py: Python<'_>, error: &PyErr) -> PyErr {
    let given = "give a number of stillroom.kitchens(\"train\"), a stillroom.Kitchen, or scene=\"scene.toml\"";
    PyErr::from_type(error.get_type(py), format!("{}: {given}", error.value(py)))
}

#[pymethods]
impl Kitchen {
    /// Kitchen `number`, or the scene in the TOML file `scene`, as number `scene_index` of several.
    #[new]
    #[pyo3(signature = (number=None, *, scene=None, scene_index=None))]
    fn new(
        py: Python<'_>,
        number: Option<&Bound<'_, PyAny>>,
        scene: Option<&Bound<'_, PyAny>>,
        scene_index: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let origin = match (number, scene) {
            (Some(number), None) => {
                let number = whole("kitchen", number, KitchenId::LAST_PROCEDURAL.into(), 1);
                Origin::BuiltIn(number.map_err(|error| explained(py, &error))? as u32)
            }
            (None, Some(scene)) => {
                let path = argument::path("scene", scene)?;
                let most = KitchenId::SCENES_MAX as u64 - 1;
                let index = scene_index.map_or(Ok(0), |index| whole("scene_index", index, most, 0))? as usize;
                let nowhere = |error| PyValueError::new_err(format!("scene is no path: {error}"));
                Origin::Scene { path: std::path::absolute(path).map_err(nowhere)?, index }
            }
            _ => return Err(PyValueError::new_err("give either the number of a kitchen or the path of a scene")),
        };
        let room = py.detach(|| Room::of(origin, SimulationConfig::default()))?;
        Ok(Self { room })
    }

    /// Number of a built-in kitchen, or 128 and up for scenes.
    #[getter]
    fn number(&self) -> u32 {
        self.room.kitchen.id().number()
    }

    /// Names of the movable objects, in the order of every array about objects.
    #[getter]
    fn objects(&self) -> Vec<String> {
        let kitchen = &self.room.kitchen;
        kitchen.bodies()[kitchen.movable_bodies()].iter().map(|body| body.name.clone()).collect()
    }

    /// Masses of the movable objects, kilograms.
    #[getter]
    fn masses_kg(&self) -> Vec<f32> {
        let kitchen = &self.room.kitchen;
        kitchen.movable_bodies().map(|body| kitchen.matter(body).map_or(0.0, |matter| matter.mass_kg)).collect()
    }

    /// Number of fixed episodes: 720 in validation and test kitchens, 0 in others.
    #[getter]
    fn fixed_episodes(&self) -> usize {
        self.room.fixed().map_or(0, <[Episode]>::len)
    }

    /// The kitchen in its settled state as MJCF, `MuJoCo`'s scene format.
    fn mjcf(&self) -> String {
        mjcf::mjcf(&self.room.kitchen, SimulationConfig::default().timestep_s)
    }

    fn __deepcopy__(&self, _memo: &Bound<'_, PyAny>) -> Self {
        self.clone()
    }

    /// Another process builds or reads it again.
    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyTuple>> {
        let (number, path, index) = match &slf.get().room.origin {
            Origin::BuiltIn(number) => (Some(*number), None, 0),
            Origin::Scene { path, index } => (None, Some(path.clone()), *index),
        };
        (slf.get_type().getattr("_again")?, (number, path, index)).into_pyobject(slf.py())
    }

    #[staticmethod]
    fn _again(
        py: Python<'_>,
        number: Option<&Bound<'_, PyAny>>,
        scene: Option<&Bound<'_, PyAny>>,
        index: &Bound<'_, PyAny>,
    ) -> PyResult<Self> {
        Self::new(py, number, scene, Some(index))
    }

    fn __repr__(&self) -> String {
        match &self.room.origin {
            Origin::BuiltIn(number) => format!("Kitchen({number})"),
            Origin::Scene { path, .. } => format!("Kitchen(scene={:?})", path.display().to_string()),
        }
    }
}
