//! Which episodes a run's environments play: sampled ones, or in an evaluation those of its plan, fixed or drawn.

use super::drawn::drawn;
use super::fixed::{EpisodesError, category, fixed};
use crate::environment::{Environment, EnvironmentError};
use crate::episode::Episode;
use crate::kitchen::Kitchen;
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::evaluation::{Distribution, Plan};
use std::sync::Arc;

/// The episodes of one kitchen's environments in a run.
#[derive(Debug)]
pub struct Programme {
    /// None in a run that trains.
    planned: Option<Planned>,
}

/// The episodes of an evaluation.
#[derive(Debug)]
struct Planned {
    plan: Plan,
    config: Config,
    /// None where they are drawn.
    fixed: Option<Vec<Episode>>,
}

impl Programme {
    /// What `config` has the environments of `kitchen` play.
    pub fn of(config: &Config, kitchen: &Kitchen) -> Result<Self, EpisodesError> {
        let (Some(asked), Some(plan)) = (&config.evaluation, config.evaluation_plan()) else {
            return Ok(Self { planned: None });
        };
        let fixed = match asked.distribution {
            Distribution::Fixed => Some(fixed(kitchen)?),
            Distribution::Run => {
                let here = |&episode: &u32| !kitchen.target_spots(category(episode as usize)).is_empty();
                if let Some(&episode) = plan.episodes_in(kitchen.id()).iter().find(|episode| !here(episode)) {
                    let target = category(episode as usize).name();
                    return Err(EpisodesError::NoTarget { kitchen: kitchen.id(), target });
                }
                None
            }
        };
        Ok(Self { planned: Some(Planned { plan, config: config.clone(), fixed }) })
    }

    /// An environment at the start of its episode with this number.
    pub fn environment(
        &self,
        kitchen: &Arc<Kitchen>,
        id: EnvironmentId,
        number: u32,
        config: &Config,
    ) -> Result<Environment, EnvironmentError> {
        let episode = match &self.planned {
            None => Episode::sample(kitchen, &config.episode, config.seed, id, number),
            Some(planned) => planned.episode(kitchen, id, number),
        };
        let mut environment = Environment::checked(Arc::clone(kitchen), id, config, number, episode)?;
        self.name(&mut environment, id, number);
        Ok(environment)
    }

    /// In an evaluation: equal episodes have equal state hashes, whichever environment plays them.
    fn name(&self, environment: &mut Environment, id: EnvironmentId, number: u32) {
        let by_kitchen = |planned: &&Planned| planned.config.evaluation.as_ref().is_some_and(|it| it.hashes_by_kitchen);
        if let Some(dealt) = self.planned.as_ref().filter(by_kitchen).and_then(|planned| planned.plan.dealt(id, number))
        {
            environment.hash_as(dealt);
        }
    }

    /// In an evaluation: the number in its table of the episode that an environment plays as its episode `number`.
    pub fn dealt(&self, id: EnvironmentId, number: u32) -> Option<u32> {
        self.planned.as_ref().and_then(|planned| planned.plan.dealt(id, number))
    }

    /// Resets an environment to the start of its episode with this number.
    pub fn start(&self, environment: &mut Environment, id: EnvironmentId, number: u32) {
        match &self.planned {
            None => environment.start_episode(number),
            Some(planned) => {
                let episode = planned.episode(environment.kitchen(), id, number);
                environment.begin_episode(number, episode);
                self.name(environment, id, number);
            }
        }
    }

    /// Prepares that start, if the environment is in the episode's kitchen already: see [`Environment::prepare`].
    pub fn prepare(&self, environment: &mut Environment, id: EnvironmentId, number: u32) -> bool {
        match &self.planned {
            None => environment.prepare_episode(number),
            Some(planned) => environment.prepare(number, |it| planned.episode(it.kitchen(), id, number)),
        }
    }
}

impl Planned {
    /// The episode that an environment plays under this number. One that has run out stands at the start of some
    /// episode of the kitchen and holds.
    fn episode(&self, kitchen: &Arc<Kitchen>, id: EnvironmentId, number: u32) -> Episode {
        match (&self.fixed, self.plan.dealt(id, number)) {
            (Some(fixed), dealt) => fixed[dealt.unwrap_or(0) as usize],
            (None, Some(dealt)) => drawn(kitchen, &self.config.episode, dealt),
            (None, None) => Episode::sample(kitchen, &self.config.episode, self.config.seed, id, 0),
        }
    }
}
