//! The environment: an episode of the task in a kitchen. An action's outcome is a [`Transition`], the present
//! observation a [`Current`].

use super::episode::{Episode, at_goal};
use super::episodes::{episode, fixed_of};
use super::step::{Current, Transition, goal_m};
use crate::environment::{self, Base};
use crate::kitchen::Kitchen;
use crate::physics::geometry::rotation_y;
use crate::robot::action::Action;
use crate::robot::configuration::Configuration;
use crate::simulation::{Start, Way};
use crate::tasks::run::{OpenError, Run, check_kitchen};
use proto::config::Config;
use proto::episode::EnvironmentId;
use rapier3d::math::{Pose3, Vec3};
use std::ops::{Deref, DerefMut};
use std::sync::Arc;

/// One environment: the kitchen during an episode, what is to be done there, and reward parts.
#[derive(Debug, Clone)]
pub struct Environment {
    base: Base,
    run: Arc<Run>,
    id: EnvironmentId,
    /// The kitchen's, in an evaluation that plays them.
    fixed: Option<Arc<[Episode]>>,
    episode: Episode,
    target: usize,
    previous_action: Option<Action>,
    // Distances after the last step; none before the first, whose progress is 0 by definition.
    distances: Option<Distances>,
    peak_disturbance_m: f64,
    peak_farthest_m: f32,
}

#[derive(Debug, Clone, Copy)]
struct Distances {
    wrist_object_m: f32,
    object_goal_m: f32,
}

impl Environment {
    /// An environment of a run, at the start of its episode with this number.
    pub fn open(run: &Arc<Run>, kitchen: Arc<Kitchen>, id: EnvironmentId, number: u32) -> Result<Self, OpenError> {
        check_kitchen(&kitchen, id)?;
        let fixed = fixed_of(run, &kitchen).map_err(|cause| OpenError::NoEpisodes(cause.to_string()))?;
        let episode = episode(run, &kitchen, fixed.as_deref(), id, number);
        let hashed = run.hashed_number(id, number);
        let environment = Self::with(Arc::clone(run), kitchen, id, hashed, episode);
        Ok(Self { fixed, ..environment })
    }

    pub fn new(kitchen: Arc<Kitchen>, id: EnvironmentId, config: &Config) -> Result<Self, OpenError> {
        Self::open(&Run::of(config), kitchen, id, 0)
    }

    /// An environment at the start of a given episode: evaluation and tests choose their own.
    pub fn with_episode(
        kitchen: Arc<Kitchen>,
        id: EnvironmentId,
        config: &Config,
        episode_number: u32,
        episode: Episode,
    ) -> Self {
        Self::with(Run::of(config), kitchen, id, episode_number, episode)
    }

    fn with(run: Arc<Run>, kitchen: Arc<Kitchen>, id: EnvironmentId, hashed_number: u32, episode: Episode) -> Self {
        let (target, start) = (kitchen.target_movable(episode.category), start(&kitchen, &episode));
        Self {
            base: Base::new(kitchen, &run.config, hashed_number, start),
            run,
            id,
            fixed: None,
            episode,
            target,
            previous_action: None,
            distances: None,
            peak_disturbance_m: 0.0,
            peak_farthest_m: 0.0,
        }
    }

    pub fn start_episode(&mut self, number: u32) {
        let episode = episode(&self.run, self.kitchen(), self.fixed.as_deref(), self.id, number);
        self.begin_episode(self.run.hashed_number(self.id, number), episode);
    }

    /// Resets to the settled kitchen and begins a given episode under this number.
    pub fn begin_episode(&mut self, number: u32, episode: Episode) {
        self.base.begin(number, start(self.kitchen(), &episode));
        self.target = self.kitchen().target_movable(episode.category);
        self.episode = episode;
        self.previous_action = None;
        self.distances = None;
        self.peak_disturbance_m = 0.0;
        self.peak_farthest_m = 0.0;
    }

    /// Prepares the start of the episode that [`Environment::start_episode`] begins with this number, by a piece of work
    /// of about a quarter of a millisecond. Returns whether there is more to do. The episode is the same without it.
    pub(crate) fn prepare_episode(&mut self, number: u32) -> bool {
        let Self { base, run, fixed, id, .. } = self;
        base.prepare(run.hashed_number(*id, number), |kitchen| {
            start(kitchen, &episode(run, kitchen, fixed.as_deref(), *id, number))
        })
    }

    /// Takes one action. It never resets the environment; [`Base::end`] shows when the episode has ended. Panics if the
    /// episode has ended: the caller starts the next one first.
    pub fn step(&mut self, action: Action) -> Transition {
        assert!(!self.ended(), "the episode has ended: start the next one before the next action");
        let was_holding = self.simulation().holding();
        let succeeded = self.carry_out(action);
        self.conclude(action, was_holding, succeeded)
    }

    /// Where an action takes the robot, for a physics engine that moves the things in place of ours;
    /// [`Environment::finish`] then has what came of it.
    pub fn way(&mut self, action: Action) -> Way {
        let next = self.robot().after(action);
        let simulation = &mut self.base.simulation;
        match (action, next) {
            (Action::PickUpMidLevel, _) => simulation.stay(simulation.would_hold(self.target)),
            (Action::DoneMidLevel | Action::LookUp | Action::LookDown, _) | (_, None) => {
                simulation.stay(next.is_some())
            }
            (_, Some(next)) => simulation.way(&next),
        }
    }

    /// Takes the action whose [`Environment::way`] the robot has gone: `arrived`, or back again. The movable things are
    /// now here. Panics if the episode has ended, or there are more poses than things.
    pub fn finish(&mut self, action: Action, arrived: bool, world_from_movables: &[Pose3]) -> Transition {
        assert!(!self.ended(), "the episode has ended: start the next one before the next action");
        let was_holding = self.simulation().holding();
        if arrived && action == Action::PickUpMidLevel {
            self.base.simulation.attach(self.target);
        }
        let robot = *self.robot();
        let robot = if arrived { robot.after(action).unwrap_or(robot) } else { robot };
        self.base.simulation.place(robot, world_from_movables);
        let succeeded = match action {
            Action::DoneMidLevel => self.is_done(),
            _ => arrived,
        };
        self.conclude(action, was_holding, succeeded)
    }

    /// Counts an action that was carried out.
    fn conclude(&mut self, action: Action, was_holding: bool, succeeded: bool) -> Transition {
        let holding = self.simulation().holding();
        let done = action == Action::DoneMidLevel;
        self.previous_action = Some(action);
        let now = Distances {
            wrist_object_m: (self.simulation().wrist() - self.target_position()).length(),
            object_goal_m: (self.target_position() - self.episode.goal).length(),
        };
        let before = self.distances.replace(now).unwrap_or(now);
        let [before_it, displacement] = self.base.count(done);
        self.peak_disturbance_m = self.peak_disturbance_m.max(displacement.total_m);
        self.peak_farthest_m = self.peak_farthest_m.max(displacement.farthest_m);
        let one_if = |condition: bool| f32::from(u8::from(condition));
        Transition {
            wrist_object_progress_m: before.wrist_object_m - now.wrist_object_m,
            object_goal_progress_m: before.object_goal_m - now.object_goal_m,
            disturbance_progress_m: (before_it.total_m - displacement.total_m) as f32,
            failed_action: one_if(!succeeded),
            picked_up: one_if(holding && !was_holding),
            goal_success: one_if(done && succeeded),
            disturbance_m: displacement.total_m as f32,
            peak_disturbance_m: self.peak_disturbance_m as f32,
            wrist_object_m: now.wrist_object_m,
            object_goal_m: now.object_goal_m,
            disturbed_objects: displacement.disturbed,
            ever_disturbed_objects: self.ever_disturbed(),
            farthest_m: displacement.farthest_m,
            peak_farthest_m: self.peak_farthest_m,
            held: u32::from(holding),
            target: u32::from(self.episode.category.index()),
        }
    }

    pub fn current(&self) -> Current {
        let configuration = self.simulation().configuration();
        let (wrist, target, goal) = (self.simulation().wrist(), self.target_position(), self.episode.goal);
        let robot_from_world = rotation_y(-configuration.yaw_rad());
        let holding = self.simulation().holding();
        let wrist_to_object_m = (robot_from_world * (target - wrist)).to_array();
        let object_to_goal_m = (robot_from_world * (goal - target)).to_array();
        Current {
            goal_m: goal_m(self.run.config.network.carried_goal, holding, wrist_to_object_m, object_to_goal_m),
            wrist_to_object_m,
            object_to_goal_m,
            holding: u32::from(holding),
            current_target: u32::from(self.episode.category.index()),
            base_position_m: [configuration.x_m, configuration.z_m],
            base_yaw_rad: configuration.yaw_rad(),
            camera_pitch_rad: configuration.camera_pitch_rad(),
            wrist_position_m: wrist.to_array(),
            target_position_m: target.to_array(),
            goal_position_m: goal.to_array(),
        }
    }

    pub fn episode(&self) -> &Episode {
        &self.episode
    }

    /// The last action of this episode; none before the first.
    pub fn previous_action(&self) -> Option<Action> {
        self.previous_action
    }

    /// Carries an action out; whether it succeeded.
    fn carry_out(&mut self, action: Action) -> bool {
        match action {
            Action::PickUpMidLevel => self.base.simulation.pick_up(self.target),
            Action::DoneMidLevel => {
                self.base.simulation.idle();
                self.is_done()
            }
            Action::LookUp | Action::LookDown => match self.robot().after(action) {
                Some(next) => {
                    self.base.simulation.look(next);
                    true
                }
                None => self.stand_still(),
            },
            _ => match self.robot().after(action) {
                Some(next) => self.base.simulation.perform(next),
                None => self.stand_still(),
            },
        }
    }

    /// Whether declaring the task done would be right.
    fn is_done(&self) -> bool {
        self.simulation().holding() && at_goal(self.target_position(), self.episode.goal)
    }

    fn target_position(&self) -> Vec3 {
        self.simulation().movable_pose(self.target).translation
    }

    fn stand_still(&mut self) -> bool {
        self.base.simulation.idle();
        false
    }
}

impl environment::Environment for Environment {
    fn begin(&mut self, number: u32) {
        self.start_episode(number);
    }

    fn prepare(&mut self, number: u32) -> bool {
        self.prepare_episode(number)
    }

    fn act(&mut self, action: &[u8], done: &mut [u8]) {
        let action = Action::from_index(action[0]).expect("only actions of the task are taken");
        self.step(action).write(done);
    }

    fn observe(&self, seen: &mut [u8]) {
        self.current().write(seen);
    }

    fn before_first(&self, done: &mut [u8]) {
        let Current { current_target, wrist_to_object_m, object_to_goal_m, .. } = self.current();
        let length = |[x, y, z]: [f32; 3]| (x * x + y * y + z * z).sqrt();
        let (wrist_object_m, object_goal_m) = (length(wrist_to_object_m), length(object_to_goal_m));
        Transition { target: current_target, wrist_object_m, object_goal_m, ..Transition::default() }.write(done);
    }

    fn base(&self) -> &Base {
        &self.base
    }

    fn base_mut(&mut self) -> &mut Base {
        &mut self.base
    }

    fn boxed(&self) -> Box<dyn environment::Environment> {
        Box::new(self.clone())
    }
}

impl Deref for Environment {
    type Target = Base;
    fn deref(&self) -> &Base {
        &self.base
    }
}

impl DerefMut for Environment {
    fn deref_mut(&mut self) -> &mut Base {
        &mut self.base
    }
}

fn start(kitchen: &Kitchen, episode: &Episode) -> Start {
    let Episode { category, start, stand, .. } = *episode;
    let robot = Configuration::start(stand.x_m, stand.z_m, stand.yaw_ticks);
    Start { robot, set_down: Some((kitchen.target_movable(category), start)) }
}
