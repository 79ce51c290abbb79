//! The policy of a checkpoint: its weights, and what they were trained for.

use proto::checkpoint::{Manifest, ManifestError};
use proto::config::{CarriedGoal, Config, GoalCoordinates};
use proto::digest::sha256;
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensorError, SafeTensors};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// In a checkpoint the names of the weights begin so; beside them lie Adam's moments, beliefs and environments.
const PREFIX: &str = "model.";

/// Heads of auxiliary tasks and whatever else is trained but does not act have other names.
const ACTING: [&str; 6] =
    ["visual_encoder.", "goal_embedder.", "previous_action_embedder.", "belief.", "actor.", "critic."];

/// Why a checkpoint gives no policy.
#[derive(Debug, thiserror::Error)]
pub enum PolicyError {
    /// The manifest cannot be used.
    #[error("{path} {problem}", path = .path.display())]
    Manifest {
        /// The manifest.
        path: PathBuf,
        /// Why.
        problem: ManifestError,
    },
    /// The tensors cannot be read.
    #[error("{path} cannot be read: {problem}", path = .path.display())]
    Unreadable {
        /// The tensors' file.
        path: PathBuf,
        /// Why.
        problem: std::io::Error,
    },
    /// The tensors are not those of the manifest.
    #[error("{path} is damaged: its SHA-256 is not the one that its manifest names", path = .path.display())]
    Damaged {
        /// The tensors' file.
        path: PathBuf,
    },
    /// Not a file of tensors.
    #[error("{path} is no safetensors file: {problem}", path = .path.display())]
    Tensors {
        /// The tensors' file.
        path: PathBuf,
        /// Why.
        problem: SafeTensorError,
    },
    /// A weight is missing, or is not what the network has there.
    #[error("the weights do not fit the network of the configuration: {name} {problem}")]
    Weight {
        /// The weight's name.
        name: String,
        /// Why.
        problem: String,
    },
    /// The weights cannot be written.
    #[error("{path} cannot be written: {problem}", path = .path.display())]
    Unwritten {
        /// The file.
        path: PathBuf,
        /// Why.
        problem: SafeTensorError,
    },
}

/// An array of numbers, row-major.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Array {
    pub shape: Vec<usize>,
    pub values: Vec<f32>,
}

/// The policy of a checkpoint.
#[derive(Debug)]
pub struct Policy {
    /// The checkpoint's manifest.
    pub manifest: Manifest,
    /// The run's configuration.
    pub config: Config,
    weights: BTreeMap<String, Array>,
}

impl Policy {
    /// Reads the checkpoint with this manifest, whose tensors lie beside it, of a run with this configuration.
    pub fn read(manifest: &Path, config: Config) -> Result<Self, PolicyError> {
        let problem = |problem| PolicyError::Manifest { path: manifest.to_owned(), problem };
        let read = Manifest::read(manifest).map_err(problem)?;
        // A name and no path: a manifest names nothing outside of its folder.
        let name = Path::new(&read.tensors).file_name().unwrap_or_default();
        let path = manifest.with_file_name(name);
        let bytes = proto::bounded::read(&path, read.tensors_bytes)
            .map_err(|problem| PolicyError::Unreadable { path: path.clone(), problem })?;
        if sha256(&bytes) != read.tensors_sha256 {
            return Err(PolicyError::Damaged { path });
        }
        let weights = weights_of(&bytes, &path)?;
        Ok(Self { manifest: read, config, weights })
    }

    /// Writes the weights alone, float32, under PyTorch's module paths.
    pub fn save(&self, path: &Path) -> Result<(), PolicyError> {
        let unwritten = |problem| PolicyError::Unwritten { path: path.to_owned(), problem };
        let bytes: Vec<(&String, &Array, Vec<u8>)> = self
            .weights
            .iter()
            .map(|(name, array)| (name, array, array.values.iter().flat_map(|value| value.to_le_bytes()).collect()))
            .collect();
        let views: Result<Vec<(&String, TensorView)>, SafeTensorError> = bytes
            .iter()
            .map(|(name, array, bytes)| Ok((*name, TensorView::new(Dtype::F32, array.shape.clone(), bytes)?)))
            .collect();
        // One entry: several would come in any order, and the same weights give the same file.
        let facts = serde_json::json!(self.facts()).to_string();
        let metadata = [("stillroom".to_owned(), facts)].into();
        safetensors::serialize_to_file(views.map_err(unwritten)?, Some(metadata), path).map_err(unwritten)
    }

    /// What somebody who has only the policy wants to know, by name; lists are JSON.
    pub(crate) fn facts(&self) -> BTreeMap<String, String> {
        let network = &self.config.network;
        let space = self.config.episode.action_space;
        let actions: Vec<&str> = space.actions().iter().map(|action| action.name()).collect();
        let goal = match network.goal {
            GoalCoordinates::Polar => "polar",
            GoalCoordinates::Cartesian => "cartesian",
        };
        let facts = [
            ("actions", serde_json::Value::from(actions).to_string()),
            ("depth_unit", "millimetre".to_owned()),
            ("goal_unit", "metre".to_owned()),
            ("goal_frame", "robot: x right, y up, z ahead".to_owned()),
            ("goal_coordinates", goal.to_owned()),
            ("carried_goal", self.carried_goal().to_string()),
            ("camera_fov_degrees", proto::camera::FIELD_OF_VIEW_DEG.to_string()),
            ("hidden", network.hidden.to_string()),
            ("run", self.manifest.run.clone()),
            ("rollout", self.manifest.rollout.to_string()),
            ("frames", self.manifest.frames.to_string()),
            ("weights_sha256", self.manifest.weights.clone()),
            ("producer", format!("stillroom {}", env!("CARGO_PKG_VERSION"))),
        ];
        facts.into_iter().map(|(name, value)| (name.to_owned(), value)).collect()
    }

    /// Sign of the goal vector that the weights were trained with.
    pub(crate) fn carried_goal(&self) -> CarriedGoal {
        self.manifest.carried_goal
    }

    /// The weight with this name, which must have this shape.
    pub(crate) fn weight(&self, name: &str, shape: &[usize]) -> Result<&[f32], PolicyError> {
        let wrong = |problem| PolicyError::Weight { name: name.to_owned(), problem };
        let array = self.weights.get(name).ok_or_else(|| wrong("is missing".to_owned()))?;
        if array.shape == shape {
            Ok(&array.values)
        } else {
            Err(wrong(format!("has shape {:?}, not {shape:?}", array.shape)))
        }
    }

    /// How many numbers its weights are.
    pub fn count(&self) -> usize {
        self.weights.values().map(|array| array.values.len()).sum()
    }
}

/// The weights that act, of the bytes of a checkpoint's tensors; `path` is where they are from.
fn weights_of(bytes: &[u8], path: &Path) -> Result<BTreeMap<String, Array>, PolicyError> {
    let unreadable = |problem| PolicyError::Tensors { path: path.to_owned(), problem };
    let mut weights = BTreeMap::new();
    for (name, view) in SafeTensors::deserialize(bytes).map_err(unreadable)?.iter() {
        let Some(name) = name.strip_prefix(PREFIX) else { continue };
        if !ACTING.iter().any(|part| name.starts_with(part)) {
            continue;
        }
        let wrong = |problem: &str| PolicyError::Weight { name: name.to_owned(), problem: problem.to_owned() };
        if view.dtype() != Dtype::F32 {
            return Err(wrong("is not float32"));
        }
        let (words, _) = view.data().as_chunks::<4>();
        let values: Vec<f32> = words.iter().map(|word| f32::from_le_bytes(*word)).collect();
        if !values.iter().all(|value| value.is_finite()) {
            return Err(wrong("holds a number that is not finite"));
        }
        weights.insert(name.to_owned(), Array { shape: view.shape().to_vec(), values });
    }
    Ok(weights)
}
