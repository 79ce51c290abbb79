//! A policy as a file of its own: safetensors with metadata that are enough to build the policy again
//! (`proto::policy_file`).

use crate::onnx::onnx;
use crate::policy::{Array, NORMALIZER, Policy, PolicyError, array_of, tensors_of};
use half::f16;
use proto::policy_file::{BYTES_MOST, ENTRY, PolicyFacts, configuration_alone, tensors_sha256};
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensorError, SafeTensors};
use std::path::Path;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Precision {
    Single,
    Half,
}

impl Precision {
    fn dtype(self) -> Dtype {
        match self {
            Self::Single => Dtype::F32,
            Self::Half => Dtype::F16,
        }
    }

    fn bytes(self, values: &[f32]) -> Vec<u8> {
        match self {
            Self::Single => values.iter().flat_map(|value| value.to_le_bytes()).collect(),
            Self::Half => values.iter().flat_map(|value| f16::from_f32(*value).to_le_bytes()).collect(),
        }
    }
}

/// Reads a file that [`save`] wrote: all of it is there, and what is in it fits the network that it names.
pub fn open(path: &Path) -> Result<Policy, PolicyError> {
    let bytes = proto::bounded::read(path, BYTES_MOST)
        .map_err(|problem| PolicyError::Unreadable { path: path.to_owned(), problem })?;
    let tensors = tensors_of(&bytes, path)?;
    let no_policy = |problem| PolicyError::NoPolicy { path: path.to_owned(), problem };
    let (_, header) = SafeTensors::read_metadata(&bytes)
        .map_err(|problem| PolicyError::Tensors { path: path.to_owned(), problem })?;
    let metadata = header.metadata().as_ref().map(|entries| entries.clone().into_iter().collect());
    let facts = PolicyFacts::read(metadata.as_ref(), &path.display().to_string()).map_err(no_policy)?;
    facts.verify(tensors.iter().map(|(name, view)| (name.as_str(), view.data()))).map_err(no_policy)?;
    let weights = tensors.iter().map(|(name, view)| Ok((name.clone(), array_of(name, view)?)));
    let weights = weights.collect::<Result<_, _>>()?;
    let policy = Policy { origin: facts.origin, config: facts.config, weights };
    // The graph asks for each weight by name and shape.
    onnx(&policy)?;
    Ok(policy)
}

pub fn save(policy: &Policy, path: &Path, precision: Precision) -> Result<(), PolicyError> {
    let unwritten = |problem| PolicyError::Unwritten { path: path.to_owned(), problem };
    let mut tensors: Vec<(&String, &Array, Dtype, Vec<u8>)> = Vec::new();
    for (name, array) in &policy.weights {
        // Units of the task's own may be too large or too small for 16 bits.
        let precision = if name.starts_with(NORMALIZER) { Precision::Single } else { precision };
        if precision == Precision::Half && array.values.iter().any(|value| !f16::from_f32(*value).is_finite()) {
            let problem = "holds a number that is too large for 16 bits: export it with 32".to_owned();
            return Err(PolicyError::Weight { name: name.clone(), problem });
        }
        tensors.push((name, array, precision.dtype(), precision.bytes(&array.values)));
    }
    let views: Result<Vec<(&String, TensorView)>, SafeTensorError> = tensors
        .iter()
        .map(|(name, array, dtype, bytes)| Ok((*name, TensorView::new(*dtype, array.shape.clone(), bytes)?)))
        .collect();
    let mut facts = policy.facts();
    let mut config = configuration_alone(policy.config.clone());
    config.network.carried_goal = policy.carried_goal();
    let spec = config.spec();
    if !spec.is_built_in() {
        facts.insert("task".to_owned(), spec.text().to_owned());
    }
    facts.insert("config".to_owned(), config.to_toml());
    let digest = tensors_sha256(tensors.iter().map(|(name, _, _, bytes)| (name.as_str(), bytes.as_slice())));
    facts.insert("tensors_sha256".to_owned(), digest);
    // One entry: several would come in any order, and the same weights give the same file.
    let metadata = [(ENTRY.to_owned(), serde_json::json!(facts).to_string())].into();
    safetensors::serialize_to_file(views.map_err(unwritten)?, Some(metadata), path).map_err(unwritten)
}
