//! Which episodes a run's environments play: sampled ones, or in an evaluation those of its plan, fixed or drawn.

use super::drawn::drawn;
use super::fixed::{EpisodesError, category, fixed};
use crate::kitchen::Kitchen;
use crate::tasks::arm_point_nav::environment::Environment;
use crate::tasks::arm_point_nav::episode::Episode;
use crate::tasks::run::{OpenError, check_kitchen};
use proto::config::{Config, EpisodeConfig};
use proto::episode::EnvironmentId;
use proto::evaluation::{Distribution, Plan};
use std::sync::Arc;

/// The episodes of one kitchen's environments in a run; sampled ones by default.
#[derive(Debug, Clone, Default)]
pub struct Programme {
    /// None in a run that trains.
    planned: Option<Arc<Planned>>,
}

/// The episodes of an evaluation.
#[derive(Debug)]
struct Planned {
    plan: Arc<Plan>,
    /// Whether equal episodes have equal state hashes, whichever environment plays them.
    hashes_by_kitchen: bool,
    /// None where they are drawn.
    fixed: Option<Vec<Episode>>,
}

impl Programme {
    /// What `config` has the environments of `kitchen` play.
    pub fn of(config: &Config, kitchen: &Kitchen) -> Result<Self, EpisodesError> {
        Self::planned(config, config.evaluation_plan().map(Arc::new).as_ref(), kitchen)
    }

    /// The same, where the plan of an evaluation is made already.
    pub(in crate::tasks::arm_point_nav) fn planned(
        config: &Config,
        plan: Option<&Arc<Plan>>,
        kitchen: &Kitchen,
    ) -> Result<Self, EpisodesError> {
        let (Some(asked), Some(plan)) = (&config.evaluation, plan) else {
            return Ok(Self::default());
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
        let planned = Planned { plan: Arc::clone(plan), hashes_by_kitchen: asked.hashes_by_kitchen, fixed };
        Ok(Self { planned: Some(Arc::new(planned)) })
    }

    /// An environment at the start of its episode with this number.
    pub fn environment(
        &self,
        kitchen: &Arc<Kitchen>,
        id: EnvironmentId,
        number: u32,
        config: &Config,
    ) -> Result<Environment, OpenError> {
        check_kitchen(kitchen, id)?;
        let episode = self.episode(kitchen, &config.episode, config.seed, id, number);
        let mut environment = Environment::with_episode(Arc::clone(kitchen), id, config, number, episode);
        environment.follow(self.clone(), number);
        Ok(environment)
    }

    /// In an evaluation: the number in its table of the episode that an environment plays as its episode `number`.
    pub fn dealt(&self, id: EnvironmentId, number: u32) -> Option<u32> {
        self.planned.as_ref().and_then(|planned| planned.plan.dealt(id, number))
    }

    /// The number that the state hashes of an environment's episode have, if not its own.
    pub(in crate::tasks::arm_point_nav) fn hashed_number(&self, id: EnvironmentId, number: u32) -> Option<u32> {
        let planned = self.planned.as_ref().filter(|planned| planned.hashes_by_kitchen)?;
        planned.plan.dealt(id, number)
    }

    /// The episode that an environment plays under this number. One that has run out of an evaluation's stands at the
    /// start of some episode of the kitchen and holds.
    pub(in crate::tasks::arm_point_nav) fn episode(
        &self,
        kitchen: &Kitchen,
        config: &EpisodeConfig,
        seed: u64,
        id: EnvironmentId,
        number: u32,
    ) -> Episode {
        let Some(Planned { plan, fixed, .. }) = self.planned.as_deref() else {
            return Episode::sample(kitchen, config, seed, id, number);
        };
        match (fixed, plan.dealt(id, number)) {
            (Some(fixed), dealt) => fixed[dealt.unwrap_or(0) as usize],
            (None, Some(dealt)) => drawn(kitchen, config, dealt),
            (None, None) => Episode::sample(kitchen, config, seed, id, 0),
        }
    }
}
