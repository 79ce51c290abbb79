//! One environment, which episode it plays, and what its oracle advises.

use crate::room::Room;
use oracle::{Policy, Variant};
use picture::{Canvas, Captions, Moment, Storyboard, Task};
use proto::config::Config;
use proto::episode::EnvironmentId;
use serde::{Deserialize, Serialize};
use simulator::depth::DepthCamera;
use simulator::robot::action::Action;
use simulator::tasks::arm_point_nav::Environment;
use simulator::tasks::arm_point_nav::Transition;
use simulator::tasks::arm_point_nav::episode::{Episode, GOAL_TOLERANCE_M};
use simulator::tasks::arm_point_nav::episodes::{self, EpisodesError};
use std::sync::Arc;

/// Where episodes come from. Each kind counts its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Series {
    /// As training draws them, from a seed.
    Sampled,
    /// The fixed episodes of validation and test kitchens.
    Fixed,
    /// As an evaluation draws them: the same for every seed.
    Drawn,
}

/// An episode by its number in a series.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Chosen {
    pub series: Series,
    pub number: u32,
    /// Seed of sampled episodes.
    pub seed: u64,
}

/// Why an episode cannot be played.
#[derive(Debug, thiserror::Error)]
pub enum ChoiceError {
    /// There are none of this series, or the kitchen lacks what they are about.
    #[error(transparent)]
    Episodes(#[from] EpisodesError),
    /// The number is too high.
    #[error("kitchen {kitchen} has fixed episodes 0 to {}, not {number}", count - 1)]
    NoSuchEpisode {
        kitchen: u32,
        /// How many it has.
        count: usize,
        /// What was asked for.
        number: u32,
    },
}

/// What the oracle advises, and in which step it was asked.
#[derive(Debug, Clone)]
struct Advice {
    variant: Variant,
    policy: Policy,
    step: usize,
    action: Action,
}

/// One environment.
#[derive(Clone)]
pub struct EpisodePlayer {
    /// The kitchen.
    pub room: Arc<Room>,
    /// Its settings.
    pub config: Arc<Config>,
    /// Which environment of its kitchen it is.
    pub id: EnvironmentId,
    /// The environment itself.
    pub environment: Environment,
    /// The episode that it plays.
    pub chosen: Chosen,
    /// The actions of this episode.
    pub actions: Vec<Action>,
    /// What the last one did; none before the first.
    pub transition: Option<Transition>,
    advice: Option<Advice>,
    story: Option<Arc<Storyboard>>,
}

impl EpisodePlayer {
    /// An environment at the start of an episode.
    pub fn new(room: Arc<Room>, config: Arc<Config>, number: u32, chosen: Chosen) -> Result<Self, ChoiceError> {
        let id = EnvironmentId { kitchen: room.kitchen.id(), number };
        let episode = episode(&room, &config, id, chosen)?;
        let kitchen = Arc::clone(&room.kitchen);
        let environment = Environment::with_episode(kitchen, id, &config, chosen.number, episode);
        let (actions, transition, advice, story) = (Vec::new(), None, None, None);
        Ok(Self { room, config, id, environment, chosen, actions, transition, advice, story })
    }

    /// The episode that is meant.
    pub fn draw(&self, chosen: Chosen) -> Result<Episode, ChoiceError> {
        episode(&self.room, &self.config, self.id, chosen)
    }

    /// Begins the episode that follows by itself.
    pub fn begin_next(&mut self) -> Result<(), ChoiceError> {
        let next = self.next();
        self.begin(next, self.draw(next)?);
        Ok(())
    }

    /// Begins an episode.
    pub fn begin(&mut self, chosen: Chosen, episode: Episode) {
        self.environment.begin_episode(chosen.number, episode);
        self.chosen = chosen;
        self.actions.clear();
        self.transition = None;
        self.advice = None;
        self.story = None;
    }

    /// The episode that follows by itself: the next of its series, after the last fixed one the first.
    pub fn next(&self) -> Chosen {
        let count = match self.chosen.series {
            Series::Fixed => self.room.fixed().map_or(u32::MAX, |fixed| fixed.len() as u32),
            Series::Sampled | Series::Drawn => u32::MAX,
        };
        Chosen { number: (self.chosen.number + 1) % count, ..self.chosen }
    }

    /// Whether the last action has ended the episode.
    pub fn ended(&self) -> bool {
        self.environment.ended()
    }

    /// Takes an action.
    ///
    /// # Panics
    /// If the episode has ended.
    pub fn step(&mut self, action: Action) {
        self.actions.push(action);
        self.transition = Some(self.environment.step(action));
    }

    /// What the oracle would do now. If the last action was not the one that it advised it makes new plans.
    pub fn advise(&mut self, variant: Variant) -> Action {
        let step = self.actions.len();
        let before = self.advice.take().filter(|advice| advice.variant == variant);
        let mut policy = match before {
            Some(advice) if advice.step == step => {
                let action = advice.action;
                self.advice = Some(advice);
                return action;
            }
            Some(advice) if advice.step + 1 == step && self.actions.last() == Some(&advice.action) => advice.policy,
            _ => Policy::new(variant),
        };
        let action = policy.next(&self.environment);
        self.advice = Some(Advice { variant, policy, step, action });
        action
    }

    /// What is said below a picture.
    fn captions(&self) -> Captions {
        let remark = match &self.transition {
            Some(done) if done.picked_up() => "picked up",
            Some(done) if done.failed() => "failed",
            _ => "",
        };
        let names = self.config.spec().actions.names();
        let action = self.actions.last().map_or("", |action| &names[usize::from(action.index())]);
        Captions {
            action: format!("step {} {action}", self.actions.len()),
            remark: remark.to_owned(),
            measures: format!("disturbance {:.3} m", self.environment.disturbance_m()),
            outcome: None,
        }
    }

    /// A picture for people: the depth view, the room from outside, and what happens in words.
    pub fn picture(&mut self, side: usize) -> Canvas {
        let moment = Moment::of(self.environment.simulation(), self.environment.world_from_camera(), self.captions());
        let story = match self.story.take() {
            Some(story) if story.side() == side => story,
            _ => {
                let (episode, kitchen) = (self.environment.episode(), &self.room.kitchen);
                let target = kitchen.target_movable(episode.category);
                let title = format!("Kitchen {}: bring the {}", kitchen.id(), episode.category.name());
                let goal_tolerance_m = GOAL_TOLERANCE_M;
                let task = Task { target: Some(target), goal: Some(episode.goal), goal_tolerance_m, title };
                Arc::new(Storyboard::new(Arc::clone(kitchen), task, std::slice::from_ref(&moment), side))
            }
        };
        let mut bodies = Vec::new();
        moment.world_from_bodies(&self.room.kitchen, &mut bodies);
        let mut depth_mm = vec![0; side * side];
        let mut camera = DepthCamera::new(self.room.kitchen.bodies());
        camera.render(&bodies, moment.world_from_camera, side, &mut depth_mm);
        let canvas = story.draw(&moment, &depth_mm);
        self.story = Some(story);
        canvas
    }
}

/// The episode that is meant.
fn episode(room: &Room, config: &Config, id: EnvironmentId, chosen: Chosen) -> Result<Episode, ChoiceError> {
    let kitchen = &room.kitchen;
    let number = chosen.number;
    match chosen.series {
        Series::Sampled => Ok(Episode::sample(kitchen, &config.episode, chosen.seed, id, number)),
        Series::Fixed => {
            let fixed = room.fixed()?;
            let missing = || ChoiceError::NoSuchEpisode { kitchen: kitchen.id().number(), count: fixed.len(), number };
            fixed.get(number as usize).copied().ok_or_else(missing)
        }
        Series::Drawn => {
            let category = episodes::category(number as usize);
            if kitchen.target_spots(category).is_empty() {
                return Err(EpisodesError::NoTarget { kitchen: kitchen.id(), target: category.name() }.into());
            }
            Ok(episodes::drawn(kitchen, &config.episode, number))
        }
    }
}
