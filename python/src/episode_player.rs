//! One environment, which episode it plays, and what its oracle advises.

use crate::room::Room;
use picture::{Canvas, Captions, Moment, Storyboard};
use proto::config::Config;
use proto::episode::EnvironmentId;
use rapier3d::math::Pose3;
use serde::{Deserialize, Serialize};
use simulator::depth::DepthCamera;
use simulator::environment::{Base, Environment};
use simulator::robot::action::Action;
use simulator::simulation::Way;
use simulator::tasks::arm_point_nav::Environment as ArmPointNav;
use simulator::tasks::arm_point_nav::episode::Episode;
use simulator::tasks::arm_point_nav::episodes::{self, EpisodesError};
use simulator::tasks::arm_point_nav::oracle::{Policy, Variant};
use simulator::tasks::{self, OpenError, Run};
use std::any::Any;
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

#[derive(Debug, thiserror::Error)]
pub enum ChoiceError {
    #[error(transparent)]
    Episodes(#[from] EpisodesError),
    #[error(transparent)]
    Open(#[from] OpenError),
    #[error("task {0} has neither fixed nor drawn episodes: reset with a seed, or with the option 'episode'")]
    SampledAlone(String),
    #[error("kitchen {kitchen} has fixed episodes 0 to {}, not {number}", count - 1)]
    NoSuchEpisode {
        kitchen: u32,
        /// How many it has.
        count: usize,
        number: u32,
    },
}

pub enum Start {
    /// By its number: of the seed that the environment has.
    Numbered,
    /// Another seed's: in an environment that is at its start.
    Reopened(Box<dyn Environment>),
    /// Of `ArmPointNav`.
    Given(Episode),
}

/// What the oracle advises, and in which step it was asked.
#[derive(Debug, Clone)]
struct Advice {
    variant: Variant,
    policy: Policy,
    step: usize,
    action: Action,
}

#[derive(Clone)]
pub struct EpisodePlayer {
    pub room: Arc<Room>,
    pub config: Arc<Config>,
    /// Which environment of its kitchen it is.
    pub id: EnvironmentId,
    environment: Box<dyn Environment>,
    /// That it was opened with.
    seed: u64,
    pub chosen: Chosen,
    /// The actions of this episode, by their numbers in the task.
    pub actions: Vec<u8>,
    /// What the last one did and what is seen now, as a learner receives it, without header and images.
    pub record: Vec<u8>,
    advice: Option<Advice>,
    story: Option<Arc<Storyboard>>,
}

impl EpisodePlayer {
    /// An environment at the start of an episode.
    pub fn new(room: Arc<Room>, config: Arc<Config>, number: u32, chosen: Chosen) -> Result<Self, ChoiceError> {
        let id = EnvironmentId { kitchen: room.kitchen.id(), number };
        let record = vec![0; config.spec().layout().small_bytes];
        let environment = open(&room, &config, id, chosen)?;
        let (seed, actions, advice, story) = (chosen.seed, Vec::new(), None, None);
        let mut player = Self { room, config, id, environment, seed, chosen, actions, record, advice, story };
        let start = player.draw(chosen)?;
        player.begin(chosen, start);
        Ok(player)
    }

    /// What is common to all tasks.
    pub fn base(&self) -> &Base {
        self.environment.base()
    }

    pub fn base_mut(&mut self) -> &mut Base {
        self.environment.base_mut()
    }

    /// `ArmPointNav`, whose episodes can be given, and which has an oracle; none of another task.
    pub fn arm(&self) -> Option<&ArmPointNav> {
        let environment: &dyn Any = &*self.environment;
        environment.downcast_ref()
    }

    fn arm_mut(&mut self) -> Option<&mut ArmPointNav> {
        let environment: &mut dyn Any = &mut *self.environment;
        environment.downcast_mut()
    }

    pub fn draw(&self, chosen: Chosen) -> Result<Start, ChoiceError> {
        let (kitchen, number) = (&self.room.kitchen, chosen.number);
        match chosen.series {
            Series::Sampled if chosen.seed == self.seed => Ok(Start::Numbered),
            Series::Sampled => Ok(Start::Reopened(open(&self.room, &self.config, self.id, chosen)?)),
            _ if self.arm().is_none() => Err(ChoiceError::SampledAlone(self.config.task.clone())),
            Series::Fixed => {
                let fixed = self.room.fixed()?;
                let (kitchen, count) = (kitchen.id().number(), fixed.len());
                let missing = || ChoiceError::NoSuchEpisode { kitchen, count, number };
                fixed.get(number as usize).copied().map(Start::Given).ok_or_else(missing)
            }
            Series::Drawn => {
                let category = episodes::category(number as usize);
                if kitchen.target_spots(category).is_empty() {
                    return Err(EpisodesError::NoTarget { kitchen: kitchen.id(), target: category.name() }.into());
                }
                Ok(Start::Given(episodes::drawn(kitchen, &self.config.episode, number)))
            }
        }
    }

    /// Begins the episode that follows by itself.
    pub fn begin_next(&mut self) -> Result<(), ChoiceError> {
        let next = self.next();
        self.begin(next, self.draw(next)?);
        Ok(())
    }

    pub fn begin(&mut self, chosen: Chosen, start: Start) {
        match start {
            Start::Numbered => self.environment.begin(chosen.number),
            Start::Reopened(environment) => (self.environment, self.seed) = (environment, chosen.seed),
            Start::Given(episode) => {
                if let Some(arm) = self.arm_mut() {
                    arm.begin_episode(chosen.number, episode);
                }
            }
        }
        self.chosen = chosen;
        self.actions.clear();
        self.advice = None;
        self.story = None;
        self.record.fill(0);
        let layout = self.config.spec().layout();
        self.environment.before_first(&mut self.record[layout.of_action.clone()]);
        self.environment.observe(&mut self.record[layout.seen.clone()]);
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
        self.base().ended()
    }

    /// Takes an action of the task.
    ///
    /// # Panics
    /// If the episode has ended.
    pub fn step(&mut self, action: u8) {
        self.actions.push(action);
        let layout = self.config.spec().layout();
        self.record[layout.action.offset] = action;
        self.environment.act(&[action], &mut self.record[layout.of_action.clone()]);
        self.environment.observe(&mut self.record[layout.seen.clone()]);
    }

    /// Where an action of `ArmPointNav` takes the robot, for another physics engine; nothing of another task.
    pub fn way(&mut self, action: u8) -> Option<Way> {
        Some(self.arm_mut()?.way(Action::from_index(action)?))
    }

    /// Takes the action whose way the robot has gone, `arrived` or back again, while another engine moved the things.
    ///
    /// # Panics
    /// If the episode has ended, or there are more poses than things.
    pub fn finish(&mut self, action: u8, arrived: bool, world_from_movables: &[Pose3]) {
        let Some(taken) = Action::from_index(action) else { return };
        let Some(done) = self.arm_mut().map(|arm| arm.finish(taken, arrived, world_from_movables)) else { return };
        self.actions.push(action);
        let layout = self.config.spec().layout();
        self.record[layout.action.offset] = action;
        done.write(&mut self.record[layout.of_action.clone()]);
        self.environment.observe(&mut self.record[layout.seen.clone()]);
    }

    /// What the oracle would do now, if the task has one. If the last action was not the one that it advised it makes new
    /// plans.
    pub fn advise(&mut self, variant: Variant) -> Option<u8> {
        let step = self.actions.len();
        let before = self.advice.take().filter(|advice| advice.variant == variant);
        let last = self.actions.last().copied();
        let mut policy = match before {
            Some(advice) if advice.step == step => {
                let action = advice.action;
                self.advice = Some(advice);
                return Some(action.index());
            }
            Some(advice) if advice.step + 1 == step && last == Some(advice.action.index()) => advice.policy,
            _ => Policy::new(variant),
        };
        let action = policy.next(self.arm()?);
        self.advice = Some(Advice { variant, policy, step, action });
        Some(action.index())
    }

    /// What is said below a picture.
    fn captions(&self) -> Captions {
        let step = self.actions.len();
        if step == 0 {
            return Captions { action: "step 0".to_owned(), ..Captions::default() };
        }
        let captions = picture::captions(self.config.spec(), &self.record);
        Captions { action: format!("step {step} {}", captions.action), ..captions }
    }

    /// A picture for people: the depth view, the room from outside, and what happens in words.
    pub fn picture(&mut self, side: usize) -> Canvas {
        let base = self.base();
        let moment = Moment::of(base.simulation(), base.world_from_camera(), self.captions());
        let story = match self.story.take() {
            Some(story) if story.side == side => story,
            _ => {
                let (spec, kitchen) = (self.config.spec(), &self.room.kitchen);
                let target = picture::target_name(spec, &self.record).map(|target| format!(": bring the {target}"));
                let title = format!("Kitchen {}{}", kitchen.id(), target.unwrap_or_default());
                let task = picture::task(spec, self.base(), &self.record, title);
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

/// An environment of the settings' task at the start of a sampled episode.
fn open(room: &Room, config: &Config, id: EnvironmentId, chosen: Chosen) -> Result<Box<dyn Environment>, OpenError> {
    let run = Run::of(&Config { seed: chosen.seed, ..config.clone() });
    tasks::open(&run, &room.kitchen, id, chosen.number)
}
