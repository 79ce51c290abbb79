//! The part in a run of a process that simulates environments of others.

use super::notes::Notes;
use super::{Guest, Served};
use crate::{EngineError, Environments, Link};
use proto::bounded;
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::run_folder::RunFolder;
use proto::task::Description;
use std::convert::Infallible;
use std::path::{Path, PathBuf};
use wire::WireAddress;

#[derive(Debug, thiserror::Error)]
pub enum GuestError {
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
}

/// An actor of a run, whose environments are a guest's.
#[derive(Debug)]
pub struct GuestActor {
    config: Config,
    folder: RunFolder,
    wire: WireAddress,
    number: u32,
    incarnation: u32,
}

impl GuestActor {
    /// Reads the run's configuration.
    pub fn open(number: u32, incarnation: u32, wire: &str, path: &Path) -> Result<Self, GuestError> {
        let text = bounded::read_text(path).map_err(|cause| GuestError::Unreadable { path: path.to_owned(), cause })?;
        let config = Config::from_toml(&text, &path.display().to_string())?;
        if config.environment.is_none() {
            return Err(GuestError::BuiltIn { path: path.to_owned() });
        }
        let folder = RunFolder::new(path.parent().unwrap_or(Path::new("")));
        Ok(Self { config, folder, wire: wire.parse()?, number, incarnation })
    }

    pub fn config(&self) -> &Config {
        &self.config
    }

    pub fn environments(&self) -> u32 {
        self.config.actors.environments_per_actor
    }

    /// Refuses an environment that is not as the run's task is declared. `description` is JSON.
    pub fn check(&self, description: &str) -> Result<(), GuestError> {
        let description: Description = serde_json::from_str(description)?;
        Ok(description.check(self.config.spec())?)
    }

    /// Takes part in the run until something fails.
    pub fn run(&self, guest: impl Guest) -> Result<Infallible, GuestError> {
        let Self { config, folder, wire, number, incarnation } = self;
        let path = folder.actor_notes(*number);
        // A full disk ends no actor: a learner saves later, too.
        let unnoted = |cause: &std::io::Error| tracing::warn!("{} cannot be written: {cause}", path.display());
        let notes = Notes::create(&path).inspect_err(unnoted).ok();
        let count = self.environments();
        let served = Served::new(guest, count as usize, notes, config);
        let homes: Vec<EnvironmentId> =
            (0..count).map(|index| EnvironmentId::among(config.kitchens(), *number, index, count)).collect();
        let ended = Environments::new(served, &homes, config).and_then(|mut environments| {
            let link = Link::open(wire, *number, config)?;
            tracing::info!(environments = count, incarnation, "ready");
            crate::run(&link, &mut environments, *incarnation)
        });
        ended.map_err(|cause| GuestError::Engine { actor: *number, cause })
    }
}
