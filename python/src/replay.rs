//! Recorded episodes of an environment of Python, simulated again.

use crate::error::value_error;
use crate::served::{Observed, Served};
use engine::Simulator;
use proto::config::Config;
use proto::record::End;
use proto::replay::{Performance, PlayError, Player, RecordedEpisode, ReplaySetup, Rules, play};
use proto::task::Description;
use pyo3::prelude::*;
use std::error::Error;

/// Simulates episodes of one run again. Requests and verdicts are the lines of `proto::replay`.
#[pyclass(module = "stillroom._stillroom")]
pub struct Replay {
    rules: Rules,
    served: Served,
}

#[pymethods]
impl Replay {
    /// `setup` is the first line.
    #[new]
    #[expect(clippy::needless_pass_by_value, reason = "PyO3 hands arguments over")]
    fn new(setup: &str, environment: Bound<'_, PyAny>, description: &str, observed: Vec<Observed>) -> PyResult<Self> {
        let setup: ReplaySetup = serde_json::from_str(setup).map_err(value_error)?;
        let config = Config::from_toml(&setup.config, "the setup's configuration").map_err(value_error)?;
        let description: Description = serde_json::from_str(description).map_err(value_error)?;
        description.check(config.spec()).map_err(value_error)?;
        let rules = Rules::of(&config).map_err(value_error)?;
        Ok(Self { rules, served: Served::new(&[environment], &observed, None, &config)? })
    }

    /// The verdict on the episode of a further line.
    fn verdict(&mut self, py: Python<'_>, line: &str) -> PyResult<String> {
        let recorded: RecordedEpisode = serde_json::from_str(line).map_err(value_error)?;
        let Self { rules, served } = self;
        let verdict = py.detach(|| {
            let state_hash = served.begin(0, recorded.environment, recorded.episode)?;
            let mut played = Played { served, state_hash, end: None };
            let performance = play(rules, &mut played, &recorded, |_, _| Ok::<(), PlayError>(()))?;
            let Performance { verdict, .. } = performance;
            Ok::<_, Box<dyn Error + Send + Sync>>(verdict)
        });
        let verdict = verdict.map_err(|error| value_error(Failed(error)))?;
        serde_json::to_string(&verdict).map_err(value_error)
    }
}

/// Why an episode cannot be simulated.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
struct Failed(Box<dyn Error + Send + Sync>);

/// The environment in an episode.
struct Played<'a> {
    served: &'a mut Served,
    state_hash: u64,
    end: Option<End>,
}

impl Player for Played<'_> {
    fn act(&mut self, action: &[u8], done: &mut [u8]) -> Result<(), Box<dyn Error + Send + Sync>> {
        (self.state_hash, self.end) = self.served.act(0, action, done)?;
        Ok(())
    }

    fn observe(&mut self, seen: &mut [u8]) {
        self.served.copy_seen(0, seen);
    }

    fn state_hash(&self) -> u64 {
        self.state_hash
    }

    fn end(&self) -> Option<End> {
        self.end
    }
}
