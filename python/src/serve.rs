//! An actor's process that is a Python interpreter.

use crate::served::{Observed, Served};
use engine::{EngineError, Environments, Link};
use proto::bounded;
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::plain_file::open_plain;
use proto::random::Key;
use proto::run_folder::RunFolder;
use proto::task::Description;
use pyo3::exceptions::PySystemExit;
use pyo3::prelude::*;
use std::convert::Infallible;
use std::fs::OpenOptions;
use std::path::{Path, PathBuf};
use wire::{WireAddress, lifeline};

/// Why the process ends.
#[derive(Debug, thiserror::Error)]
enum ServeError {
    #[error("cannot read {path}: {cause}", path = .path.display())]
    Unreadable { path: PathBuf, cause: std::io::Error },
    #[error("cannot write {path}: {cause}", path = .path.display())]
    Unwritable { path: PathBuf, cause: std::io::Error },
    #[error(transparent)]
    Config(#[from] proto::config::ConfigError),
    #[error("{path} is the configuration of a run with built-in environments", path = .path.display())]
    BuiltIn { path: PathBuf },
    #[error("it does not describe itself: {0}")]
    Description(#[from] serde_json::Error),
    #[error(transparent)]
    Spec(#[from] proto::task::SpecError),
    #[error(transparent)]
    Address(#[from] wire::WireError),
    #[error("actor {actor}: {cause}")]
    Engine { actor: u32, cause: EngineError },
    #[error("{0}")]
    Python(#[from] PyErr),
}

/// The seed that a run resets an environment with for an episode: `env.reset(seed=...)` begins the same episode.
#[pyfunction]
pub fn episode_seed(seed: u64, environment: u32, episode: u32) -> u32 {
    Key::episode_seed(seed, environment, episode)
}

/// Exits, with all processes that environments have started, as soon as the orchestrator is gone.
#[pyfunction]
pub fn hold_lifeline() -> PyResult<()> {
    Ok(lifeline::hold_apart()?)
}

/// An actor of a run.
#[pyclass(frozen, module = "stillroom._stillroom")]
pub struct Actor {
    config: Config,
    folder: RunFolder,
    wire: WireAddress,
    number: u32,
    incarnation: u32,
}

#[pymethods]
impl Actor {
    /// Reads the run's configuration.
    #[new]
    #[expect(clippy::needless_pass_by_value, reason = "PyO3 hands arguments over")]
    fn new(number: u32, incarnation: u32, wire: &str, config: PathBuf) -> PyResult<Self> {
        wire::logging::to_stderr();
        Self::open(number, incarnation, wire, &config).map_err(|error| exit(&error))
    }

    /// How many environments it has.
    #[getter]
    fn environments(&self) -> u32 {
        self.config.actors.environments_per_actor
    }

    /// Takes part in the run until something fails. `description` is JSON; `observed` names each observation's channel,
    /// and its key in a dictionary.
    #[expect(clippy::needless_pass_by_value, reason = "PyO3 hands arguments over")]
    fn run(
        &self,
        py: Python<'_>,
        environments: Vec<Bound<'_, PyAny>>,
        description: &str,
        observed: Vec<Observed>,
    ) -> PyResult<()> {
        match self.take_part(py, &environments, description, &observed) {
            Err(error) => Err(exit(&error)),
            Ok(never) => match never {},
        }
    }
}

impl Actor {
    fn open(number: u32, incarnation: u32, wire: &str, path: &Path) -> Result<Self, ServeError> {
        let text = bounded::read_text(path).map_err(|cause| ServeError::Unreadable { path: path.to_owned(), cause })?;
        let config = Config::from_toml(&text, &path.display().to_string())?;
        if config.environment.is_none() {
            return Err(ServeError::BuiltIn { path: path.to_owned() });
        }
        let folder = RunFolder::new(path.parent().unwrap_or(Path::new("")));
        Ok(Self { config, folder, wire: wire.parse()?, number, incarnation })
    }

    fn take_part(
        &self,
        py: Python<'_>,
        environments: &[Bound<'_, PyAny>],
        description: &str,
        observed: &[Observed],
    ) -> Result<Infallible, ServeError> {
        let Self { config, folder, wire, number, incarnation } = self;
        let description: Description = serde_json::from_str(description)?;
        description.check(config.spec())?;
        let path = folder.last_place(*number);
        let file = open_plain(&path, OpenOptions::new().create(true).truncate(true).write(true));
        let file = file.map_err(|cause| ServeError::Unwritable { path, cause })?;
        let served = Served::new(environments, observed, Some(file), config)?;
        let count = config.actors.environments_per_actor;
        let homes: Vec<EnvironmentId> =
            (0..count).map(|index| EnvironmentId::among(config.kitchens(), *number, index, count)).collect();
        // Python's lock is free while the actor waits and sends.
        let ended = py.detach(|| {
            let mut environments = Environments::new(served, &homes, config)?;
            let link = Link::open(wire, *number, config)?;
            tracing::info!(environments = count, incarnation, "ready");
            engine::run(&link, &mut environments, *incarnation)
        });
        ended.map_err(|cause| ServeError::Engine { actor: *number, cause })
    }
}

fn exit(error: &ServeError) -> PyErr {
    let mut text = error.to_string();
    let mut source = std::error::Error::source(error);
    while let Some(cause) = source {
        text = format!("{text}: {cause}");
        source = cause.source();
    }
    tracing::error!("{text}");
    PySystemExit::new_err(1)
}
