use half::f16;
use proto::checkpoint::{Manifest, ManifestError};
use proto::config::{CarriedGoal, Config, GoalCoordinates, Memory};
use proto::digest::sha256;
use proto::disk::TENSORS_BYTES_MOST;
use proto::policy_file::{Origin, PolicyFileError};
use proto::run_folder::RunFolder;
use proto::task::{ActionHead, Inputs};
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensorError, SafeTensors};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// In a checkpoint the names of the weights begin so; beside them lie Adam's moments, beliefs and environments.
const PREFIX: &str = "model.";

/// Heads of auxiliary tasks and whatever else is trained but does not act have other names.
const ACTING: [&str; 10] = [
    NORMALIZER,
    IMAGES,
    "visual_encoder.",
    "goal_embedder.",
    "mlp.",
    "previous_action_embedder.",
    "belief.",
    "actor.",
    "critic.",
    "log_std",
];
pub(crate) const MASK: &str = "action_mask";
pub(crate) const NORMALIZER: &str = "observation_norm.";
/// Encoders of images but the frame; inputs of a model have the names, too.
pub(crate) const IMAGES: &str = "images.";

#[derive(Debug, thiserror::Error)]
pub enum PolicyError {
    #[error("{path} {problem}", path = .path.display())]
    Manifest { path: PathBuf, problem: ManifestError },
    #[error("{path} cannot be read: {problem}", path = .path.display())]
    Unreadable { path: PathBuf, problem: std::io::Error },
    #[error("{path} is damaged: its SHA-256 is not the one that its manifest names", path = .path.display())]
    Damaged { path: PathBuf },
    #[error("{path} is no safetensors file: {problem}", path = .path.display())]
    Tensors { path: PathBuf, problem: SafeTensorError },
    #[error("{path} {problem}", path = .path.display())]
    NoPolicy { path: PathBuf, problem: PolicyFileError },
    #[error("the weights do not fit the network of the configuration: {name} {problem}")]
    Weight { name: String, problem: String },
    #[error("{path} cannot be written: {problem}", path = .path.display())]
    Unwritten { path: PathBuf, problem: SafeTensorError },
}

/// An array of numbers, row-major.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Array {
    pub shape: Vec<usize>,
    pub values: Vec<f32>,
}

#[derive(Debug)]
pub struct Policy {
    pub origin: Origin,
    /// The run's configuration; of a policy file without what a file of its own cannot hold.
    pub config: Config,
    pub(crate) weights: BTreeMap<String, Array>,
}

impl Policy {
    /// Reads the checkpoint with this manifest in a run folder, whose tensors lie beside it, of a run with this
    /// configuration.
    pub fn read(run: &RunFolder, manifest: &Path, config: Config) -> Result<Self, PolicyError> {
        let problem = |problem| PolicyError::Manifest { path: manifest.to_owned(), problem };
        let read = Manifest::read_in(run, manifest).map_err(problem)?;
        // A name and no path: a manifest names nothing outside of its folder.
        let name = Path::new(&read.tensors).file_name().unwrap_or_default();
        let path = manifest.with_file_name(name);
        let bytes = run
            .read(&path, read.tensors_bytes.min(TENSORS_BYTES_MOST))
            .map_err(|problem| PolicyError::Unreadable { path: path.clone(), problem })?;
        if sha256(&bytes) != read.tensors_sha256 {
            return Err(PolicyError::Damaged { path });
        }
        let tensors = tensors_of(&bytes, &path)?;
        let named = tensors.iter().filter_map(|(name, view)| Some((name.strip_prefix(PREFIX)?, view)));
        let acting = named.filter(|(name, _)| ACTING.iter().any(|part| name.starts_with(part)));
        let weights = acting.map(|(name, view)| Ok((name.to_owned(), array_of(name, view)?)));
        let Manifest { run, rollout, frames, weights: digest, carried_goal, .. } = read;
        let origin = Origin { run, rollout, frames, weights: digest, carried_goal };
        Ok(Self { origin, config, weights: weights.collect::<Result<_, _>>()? })
    }

    pub(crate) fn action_names(&self) -> Vec<&'static str> {
        let names = self.config.spec().actions.names();
        self.config.policy_actions().into_iter().map(|action| names[usize::from(action)].as_str()).collect()
    }

    /// What somebody who has only the policy wants to know, by name; lists are JSON.
    pub(crate) fn facts(&self) -> BTreeMap<String, String> {
        let network = &self.config.network;
        let actions = self.action_names();
        let of_frames = [
            ("depth_unit", "millimetre".to_owned()),
            ("goal_unit", "metre".to_owned()),
            ("goal_frame", "robot: x right, y up, z ahead".to_owned()),
            ("goal_coordinates", network.goal.to_string()),
            ("carried_goal", self.carried_goal().to_string()),
            ("camera_fov_degrees", proto::camera::FIELD_OF_VIEW_DEG.to_string()),
        ];
        let actions = match self.config.action_head() {
            ActionHead::Discrete(_) => ("actions", serde_json::json!(actions)),
            ActionHead::MultiDiscrete(choices) => ("choices", serde_json::json!(choices)),
            ActionHead::Box(bounds) => ("bounds", serde_json::json!(bounds)),
        };
        let facts = [
            (actions.0, actions.1.to_string()),
            ("run", self.origin.run.clone()),
            ("rollout", self.origin.rollout.to_string()),
            ("frames", self.origin.frames.to_string()),
            ("weights_sha256", self.origin.weights.clone()),
            ("producer", format!("stillroom {}", env!("CARGO_PKG_VERSION"))),
        ];
        let hidden = (network.memory != Memory::None).then(|| ("hidden", network.hidden.to_string()));
        let of_frames = of_frames.into_iter().filter(|_| self.has_frame());
        let inputs = self.inputs();
        // Beginning and end of each observation.
        let places = inputs.places().map(|place| (place.name, [place.range.start, place.range.end]));
        let places: BTreeMap<&str, [usize; 2]> = places.collect();
        let is_plain = network.goal == GoalCoordinates::Plain && !places.is_empty();
        let places = is_plain.then(|| ("numbers", serde_json::json!(places).to_string()));
        let facts = facts.into_iter().chain(of_frames).chain(hidden).chain(places);
        facts.map(|(name, value)| (name.to_owned(), value)).collect()
    }

    pub(crate) fn inputs(&self) -> Inputs {
        self.config.spec().inputs().expect("a validated configuration's task has what networks take")
    }

    pub(crate) fn has_frame(&self) -> bool {
        self.inputs().frame.is_some()
    }

    /// Whether there are options that may not be chosen.
    pub(crate) fn is_masked(&self) -> bool {
        self.config.spec().mask().is_some()
    }

    /// How many numbers it is given, beside the frame if there is one.
    pub(crate) fn numbers(&self) -> usize {
        self.inputs().policy_width()
    }

    /// Whether the model gives a value: what the critic alone is given is not there where a policy acts.
    pub(crate) fn has_value(&self) -> bool {
        self.inputs().width() == self.numbers()
    }

    /// Inputs of the model that what is remembered has, each as wide as the belief.
    pub(crate) fn states(&self) -> &'static [&'static str] {
        &["belief", "cell"][..self.config.network.memory.states() as usize]
    }

    pub(crate) fn numbers_name(&self) -> &'static str {
        if self.has_frame() { "goal" } else { "numbers" }
    }

    /// Sign of the goal vector that the weights were trained with.
    pub(crate) fn carried_goal(&self) -> CarriedGoal {
        self.origin.carried_goal
    }

    pub(crate) fn weight(&self, name: &str, shape: &[usize]) -> Result<&[f32], PolicyError> {
        let wrong = |problem| PolicyError::Weight { name: name.to_owned(), problem };
        let array = self.weights.get(name).ok_or_else(|| wrong("is missing".to_owned()))?;
        if array.shape == shape {
            Ok(&array.values)
        } else {
            Err(wrong(format!("has shape {:?}, not {shape:?}", array.shape)))
        }
    }

    pub fn count(&self) -> usize {
        self.weights.values().map(|array| array.values.len()).sum()
    }
}

/// The tensors of a file by name, ascending; `path` is where its bytes are from.
pub(crate) fn tensors_of<'a>(bytes: &'a [u8], path: &Path) -> Result<BTreeMap<String, TensorView<'a>>, PolicyError> {
    let unreadable = |problem| PolicyError::Tensors { path: path.to_owned(), problem };
    Ok(SafeTensors::deserialize(bytes).map_err(unreadable)?.tensors().into_iter().collect())
}

/// A weight, widened to 32 bits.
pub(crate) fn array_of(name: &str, view: &TensorView) -> Result<Array, PolicyError> {
    let wrong = |problem: &str| PolicyError::Weight { name: name.to_owned(), problem: problem.to_owned() };
    let values: Vec<f32> = match view.dtype() {
        Dtype::F32 => view.data().as_chunks::<4>().0.iter().map(|word| f32::from_le_bytes(*word)).collect(),
        Dtype::F16 => view.data().as_chunks::<2>().0.iter().map(|word| f16::from_le_bytes(*word).to_f32()).collect(),
        _ => return Err(wrong("is neither float32 nor float16")),
    };
    if !values.iter().all(|value| value.is_finite()) {
        return Err(wrong("holds a number that is not finite"));
    }
    Ok(Array { shape: view.shape().to_vec(), values })
}
