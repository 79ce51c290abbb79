//! Which episodes a run's environments play: sampled ones, or in an evaluation the fixed ones of its plan.

use super::{EpisodesError, fixed};
use crate::environment::{Environment, EnvironmentError};
use crate::episode::Episode;
use crate::kitchen::Kitchen;
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::evaluation::Plan;
use std::sync::Arc;

/// The episodes of one kitchen's environments in a run.
#[derive(Debug)]
pub struct Programme {
    /// None in a run that trains.
    fixed: Option<(Plan, Vec<Episode>)>,
}

impl Programme {
    /// What `config` has the environments of `kitchen` play.
    pub fn of(config: &Config, kitchen: &Kitchen) -> Result<Self, EpisodesError> {
        let Some(plan) = config.evaluation_plan() else { return Ok(Self { fixed: None }) };
        Ok(Self { fixed: Some((plan, fixed(kitchen)?)) })
    }

    /// An environment at the start of its episode 0.
    pub fn environment(
        &self,
        kitchen: &Arc<Kitchen>,
        id: EnvironmentId,
        config: &Config,
    ) -> Result<Environment, EnvironmentError> {
        match &self.fixed {
            None => Environment::new(Arc::clone(kitchen), id, config),
            Some((plan, episodes)) => {
                Environment::checked(Arc::clone(kitchen), id, config, 0, choose(plan, episodes, id, 0))
            }
        }
    }

    /// In an evaluation: the fixed episode that an environment plays as its episode with this number.
    pub fn fixed(&self, id: EnvironmentId, number: u32) -> Option<u32> {
        self.fixed.as_ref().and_then(|(plan, _)| plan.fixed(id, number))
    }

    /// Resets an environment to the start of its episode with this number.
    pub fn start(&self, environment: &mut Environment, id: EnvironmentId, number: u32) {
        match &self.fixed {
            None => environment.start_episode(number),
            Some((plan, episodes)) => environment.begin_episode(number, choose(plan, episodes, id, number)),
        }
    }
}

/// The planned episode. An environment that has run out stands at the start of the kitchen's first and holds.
fn choose(plan: &Plan, episodes: &[Episode], id: EnvironmentId, number: u32) -> Episode {
    episodes[plan.fixed(id, number).unwrap_or(0) as usize]
}
