//! Which episodes a run's environments play: sampled ones, or in an evaluation those of its plan, fixed or drawn.

use super::drawn::drawn;
use super::fixed::{EpisodesError, category, fixed};
use crate::kitchen::Kitchen;
use crate::tasks::arm_point_nav::episode::Episode;
use crate::tasks::run::Run;
use proto::episode::EnvironmentId;
use proto::evaluation::Distribution;
use std::sync::Arc;

/// A kitchen's fixed episodes, if an evaluation plays them. An error if the kitchen lacks what it plays.
pub fn fixed_of(run: &Run, kitchen: &Kitchen) -> Result<Option<Arc<[Episode]>>, EpisodesError> {
    let (Some(asked), Some(plan)) = (&run.config.evaluation, &run.plan) else { return Ok(None) };
    if asked.distribution == Distribution::Fixed {
        return fixed(kitchen).map(|episodes| Some(episodes.into()));
    }
    let here = |&episode: &u32| !kitchen.target_spots(category(episode as usize)).is_empty();
    match plan.episodes_in(kitchen.id()).iter().find(|episode| !here(episode)) {
        None => Ok(None),
        Some(&episode) => {
            Err(EpisodesError::NoTarget { kitchen: kitchen.id(), target: category(episode as usize).name() })
        }
    }
}

/// The episode that an environment plays under this number. One that has run out of an evaluation's stands at the start
/// of some episode of the kitchen and holds.
pub fn episode(run: &Run, kitchen: &Kitchen, fixed: Option<&[Episode]>, id: EnvironmentId, number: u32) -> Episode {
    let config = &run.config;
    let sampled = |number| Episode::sample(kitchen, &config.episode, config.seed, id, number);
    match (fixed, run.dealt(id, number)) {
        _ if run.plan.is_none() => sampled(number),
        (Some(fixed), dealt) => fixed[dealt.unwrap_or(0) as usize],
        (None, Some(dealt)) => drawn(kitchen, &config.episode, dealt),
        (None, None) => sampled(0),
    }
}
