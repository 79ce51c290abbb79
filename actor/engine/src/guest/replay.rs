//! Recorded episodes of an environment of others, simulated again.

use super::{Guest, Served};
use crate::Simulator;
use proto::config::Config;
use proto::record::End;
use proto::replay::{Performance, PlayError, Player, RecordedEpisode, ReplaySetup, Rules, play};
use proto::task::Description;
use std::error::Error;

#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    #[error(transparent)]
    Line(#[from] serde_json::Error),
    #[error(transparent)]
    Config(#[from] proto::config::ConfigError),
    #[error(transparent)]
    Spec(#[from] proto::task::SpecError),
    #[error(transparent)]
    Failed(#[from] Box<dyn Error + Send + Sync>),
}

/// Simulates episodes of one run again. Requests and verdicts are the lines of `proto::replay`.
pub struct Replay<G> {
    rules: Rules,
    served: Served<G>,
}

impl<G: Guest> Replay<G> {
    /// `setup` is the first line, `description` JSON, and `guest` makes one environment of that run.
    pub fn new<E>(
        setup: &str,
        description: &str,
        guest: impl FnOnce(&Config) -> Result<G, E>,
    ) -> Result<Self, ReplayError>
    where
        E: Into<Box<dyn Error + Send + Sync>>,
    {
        let setup: ReplaySetup = serde_json::from_str(setup)?;
        let config = Config::from_toml(&setup.config, "the setup's configuration")?;
        let description: Description = serde_json::from_str(description)?;
        description.check(config.spec())?;
        let rules = Rules::of(&config)?;
        let guest = guest(&config).map_err(Into::into)?;
        Ok(Self { rules, served: Served::new(guest, 1, None, &config) })
    }

    /// The verdict on the episode of a further line.
    pub fn verdict(&mut self, line: &str) -> Result<String, ReplayError> {
        let recorded: RecordedEpisode = serde_json::from_str(line)?;
        let Self { rules, served } = self;
        let begun = served.begin(0, recorded.environment, recorded.episode, &mut []);
        let state_hash = begun.map_err(Box::<dyn Error + Send + Sync>::from)?;
        let mut played = Played { served, state_hash, end: None };
        let performance = play(rules, &mut played, &recorded, |_, _| Ok::<(), PlayError>(()));
        let Performance { verdict, .. } = performance.map_err(Box::<dyn Error + Send + Sync>::from)?;
        Ok(serde_json::to_string(&verdict)?)
    }
}

struct Played<'a, G> {
    served: &'a mut Served<G>,
    state_hash: u64,
    end: Option<End>,
}

impl<G: Guest> Player for Played<'_, G> {
    fn act(&mut self, action: &[u8], done: &mut [u8]) -> Result<(), Box<dyn Error + Send + Sync>> {
        self.served.act_together(0, action)?;
        (self.state_hash, self.end) = self.served.act(0, action, done, &mut [])?;
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
