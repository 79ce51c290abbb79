//! An actor's process that is a Python interpreter.

use crate::error::value_error;
use crate::served::{Observed, Served};
use engine::guest::{GuestActor, GuestError};
use proto::random::Key;
use pyo3::exceptions::PySystemExit;
use pyo3::prelude::*;
use std::path::PathBuf;
use wire::lifeline;

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
pub struct Actor(GuestActor);

#[pymethods]
impl Actor {
    /// Reads the run's configuration.
    #[new]
    #[expect(clippy::needless_pass_by_value, reason = "PyO3 hands arguments over")]
    fn new(number: u32, incarnation: u32, wire: &str, config: PathBuf) -> PyResult<Self> {
        wire::logging::to_stderr();
        GuestActor::open(number, incarnation, wire, &config).map(Self).map_err(|error| exit(&error))
    }

    /// How many environments it has.
    #[getter]
    fn environments(&self) -> u32 {
        self.0.environments()
    }

    /// Takes part in the run until something fails. `description` is JSON; `observed` names each observation's channel,
    /// and its key in a dictionary; `vectors` are the vector environments whose columns `environments` are.
    #[expect(clippy::needless_pass_by_value, reason = "PyO3 hands arguments over")]
    fn run(
        &self,
        py: Python<'_>,
        environments: Vec<Bound<'_, PyAny>>,
        vectors: Vec<Bound<'_, PyAny>>,
        description: &str,
        observed: Vec<Observed>,
    ) -> PyResult<()> {
        self.0.check(description).map_err(|error| exit(&error))?;
        let served = Served::new(&environments, &vectors, &observed, self.0.config().spec())?;
        // Python's lock is free while the actor waits and sends.
        match py.detach(|| self.0.run(served)) {
            Err(error) => Err(exit(&error)),
            Ok(never) => match never {},
        }
    }
}

fn exit(error: &GuestError) -> PyErr {
    let mut text = error.to_string();
    let mut source = std::error::Error::source(error);
    while let Some(cause) = source {
        text = format!("{text}: {cause}");
        source = cause.source();
    }
    tracing::error!("{text}");
    PySystemExit::new_err(1)
}

/// Simulates recorded episodes of one run again. Requests and verdicts are the lines of `proto::replay`.
#[pyclass(module = "stillroom._stillroom")]
pub struct Replay(engine::guest::Replay<Served>);

#[pymethods]
impl Replay {
    /// `setup` is the first line.
    #[new]
    #[expect(clippy::needless_pass_by_value, reason = "PyO3 hands arguments over")]
    fn new(
        setup: &str,
        environment: Bound<'_, PyAny>,
        vectors: Vec<Bound<'_, PyAny>>,
        description: &str,
        observed: Vec<Observed>,
    ) -> PyResult<Self> {
        let served = |config: &proto::config::Config| Served::new(&[environment], &vectors, &observed, config.spec());
        engine::guest::Replay::new(setup, description, served).map(Self).map_err(value_error)
    }

    /// The verdict on the episode of a further line.
    fn verdict(&mut self, py: Python<'_>, line: &str) -> PyResult<String> {
        py.detach(|| self.0.verdict(line)).map_err(value_error)
    }
}
