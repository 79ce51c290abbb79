//! Checkpoints and policy files, by the code that a learner reads them with. They may come from anybody: what is wrong
//! with one is a `CheckpointError` that names the file.

use crate::argument;
use crate::error::value_error;
use proto::bounded;
use proto::checkpoint::Manifest;
use proto::config::Config;
use proto::digest::sha256;
use proto::plain_file::open_plain;
use proto::policy_file::{self, PolicyFacts, PolicyFileError};
use proto::printable::printable;
use proto::task::Actions;
use pyo3::create_exception;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use safetensors::SafeTensors;
use serde::Serialize;
use std::fmt::Display;
use std::fs::OpenOptions;
use std::io::{self, ErrorKind, Read};
use std::path::{Path, PathBuf};

create_exception!(stillroom, CheckpointError, PyValueError, "A path holds no checkpoint that can be used.");

/// The tensors of a larger checkpoint are not read, bytes. The paper's have 0.1 GB.
const TENSORS_BYTES_MOST: u64 = 4 << 30;
/// What a user can do about a damaged file.
const AGAIN: &str = "copy it again, or take another checkpoint";

/// A tensor as Python makes an array of it: name, type, shape, bytes.
type Tensor<'py> = (String, String, Vec<usize>, Bound<'py, PyBytes>);

/// Of a policy file: configuration, rollout, frames, run, and the task's actions as JSON.
type Facts = (String, u64, u64, String, String);

fn refused(path: &Path, problem: impl Display) -> PyErr {
    CheckpointError::new_err(printable(&format!("{} {problem}", path.display())).into_owned())
}

/// The bytes of a plain file, not of a link, that has `most` at most.
fn plain(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let file = open_plain(path, OpenOptions::new().read(true))?;
    let mut bytes = Vec::new();
    // The length first: a long file is not read at all. Then the bound, because it may grow.
    if file.metadata()?.len() <= most && file.take(most + 1).read_to_end(&mut bytes)? as u64 <= most {
        return Ok(bytes);
    }
    Err(io::Error::new(ErrorKind::FileTooLarge, format!("it has more than the {most} bytes that it may have")))
}

/// Reads the checkpoint with this manifest: the file of its tensors, the manifest as JSON, the configuration as TOML
/// ("" where an older version wrote the checkpoint), its task's actions as JSON, and its tensors whose names begin with `prefix`.
#[pyfunction]
pub fn read_checkpoint<'py>(
    path: &Bound<'py, PyAny>,
    prefix: &str,
    verify: bool,
) -> PyResult<(PathBuf, String, String, String, Vec<Tensor<'py>>)> {
    let (py, path) = (path.py(), argument::path("path", path)?);
    let manifest = Manifest::read(&path).map_err(|problem| refused(&path, format!("{problem}; {AGAIN}")))?;
    let file = path.with_file_name(&manifest.tensors);
    if Path::new(&manifest.tensors).file_name() != Some(manifest.tensors.as_ref()) {
        let problem = format!("names tensors that are not beside it: {:?}; {AGAIN}", manifest.tensors);
        return Err(refused(&path, problem));
    }
    let (config, actions) = match manifest.config.as_str() {
        "" => (String::new(), "{}".to_owned()),
        text => {
            let config = Config::from_toml(text, "its configuration");
            let config = config.map_err(|problem| refused(&path, format!("cannot be used: {problem}; {AGAIN}")))?;
            (config.to_toml(), actions_of(&config)?)
        }
    };
    let most = manifest.tensors_bytes.min(TENSORS_BYTES_MOST);
    let bytes = py.detach(|| plain(&file, most));
    let bytes = bytes.map_err(|problem| refused(&file, format!("cannot be read: {problem}; {AGAIN}")))?;
    if verify && py.detach(|| sha256(&bytes)) != manifest.tensors_sha256 {
        let problem = format!("is damaged: its SHA-256 is not the one that its manifest names; {AGAIN}");
        return Err(refused(&file, problem));
    }
    let tensors = tensors(py, &file, &bytes, prefix)?;
    let manifest = serde_json::to_string(&manifest).map_err(|problem| refused(&path, problem))?;
    Ok((file, manifest, config, actions, tensors))
}

/// The actions of a configuration's task, as JSON, and whether they are `masked`.
fn actions_of(config: &Config) -> PyResult<String> {
    #[derive(Serialize)]
    struct Told<'a> {
        #[serde(flatten)]
        actions: &'a Actions,
        #[serde(skip_serializing_if = "std::ops::Not::not")]
        masked: bool,
    }
    let told = Told { actions: &config.spec().actions, masked: config.spec().mask().is_some() };
    serde_json::to_string(&told).map_err(value_error)
}

/// Reads a safetensors file: of a policy file also its configuration as TOML, rollout, frames, run, and its task's
/// actions as JSON.
#[pyfunction]
pub fn read_policy<'py>(path: &Bound<'py, PyAny>, verify: bool) -> PyResult<(Option<Facts>, Vec<Tensor<'py>>)> {
    let (py, path) = (path.py(), argument::path("path", path)?);
    let bytes = py.detach(|| bounded::read(&path, policy_file::BYTES_MOST));
    let bytes = bytes.map_err(|problem| refused(&path, format!("cannot be read: {problem}")))?;
    let tensors = tensors(py, &path, &bytes, "")?;
    let (_, header) = SafeTensors::read_metadata(&bytes).map_err(|problem| refused(&path, problem))?;
    let metadata = header.metadata().as_ref().map(|entries| entries.clone().into_iter().collect());
    let facts = match PolicyFacts::read(metadata.as_ref(), "its configuration") {
        Err(PolicyFileError::Nameless) => return Ok((None, tensors)),
        facts => facts.map_err(|problem| refused(&path, problem))?,
    };
    if verify {
        let pieces = tensors.iter().map(|(name, _, _, bytes)| (name.as_str(), bytes.as_bytes()));
        facts.verify(pieces).map_err(|problem| refused(&path, format!("{problem}; copy it again")))?;
    }
    let PolicyFacts { config, origin, .. } = facts;
    let actions = actions_of(&config)?;
    Ok((Some((config.to_toml(), origin.rollout, origin.frames, origin.run, actions)), tensors))
}

/// The tensors of a file whose names begin with `prefix`, ascending.
fn tensors<'py>(py: Python<'py>, path: &Path, bytes: &[u8], prefix: &str) -> PyResult<Vec<Tensor<'py>>> {
    let file = SafeTensors::deserialize(bytes);
    let file = file.map_err(|problem| refused(path, format!("is no safetensors file: {problem}; {AGAIN}")))?;
    let mut tensors = file.tensors();
    tensors.retain(|(name, _)| name.starts_with(prefix));
    tensors.sort_unstable_by(|(a, _), (b, _)| a.cmp(b));
    let tensor = |(name, view): (String, safetensors::tensor::TensorView<'_>)| {
        (name, format!("{:?}", view.dtype()), view.shape().to_vec(), PyBytes::new(py, view.data()))
    };
    Ok(tensors.into_iter().map(tensor).collect())
}
