//! One environment: an episode of the task in a kitchen. An action's outcome is a [`Transition`], the present
//! observation a [`Current`].

use crate::depth::{Backdrop, DepthCamera};
use crate::episode::{Episode, at_goal};
use crate::kitchen::Kitchen;
use crate::physics::geometry::rotation_y;
use crate::robot::configuration::Configuration;
use crate::robot::links::world_from_camera;
use crate::simulation::{Settling, Simulation, Substep};
use crate::tasks::arm_point_nav::{Current, RewardParts, Transition, goal_m};
use proto::action::Action;
use proto::camera::SUMS_PIXELS;
use proto::config::{CarriedGoal, Config, EpisodeConfig};
use proto::episode::EnvironmentId;
use proto::record::End;
use proto::reward::OBJECT_DISPLACEMENT_CAP_M;
use rapier3d::math::{Pose3, Vec3};
use std::sync::Arc;
use xxhash_rust::xxh3::xxh3_64;

/// An object that moved further than this on some axis is disturbed, metres (reference).
pub const DISTURBED_AXIS_M: f32 = 0.01;

/// Sub-steps of one piece of work of [`Environment::prepare`].
const SUBSTEPS_AT_ONCE: u32 = 8;

/// Why an environment could not be made.
#[derive(Debug, thiserror::Error)]
pub enum EnvironmentError {
    /// The kitchen is not the one the environment belongs to.
    #[error("environment of kitchen {wanted} was given kitchen {given}")]
    WrongKitchen {
        /// The environment's kitchen.
        wanted: proto::kitchen::KitchenId,
        given: proto::kitchen::KitchenId,
    },
}

/// One environment: episode, physics world, robot and reward parts.
#[derive(Debug, Clone)]
pub struct Environment {
    kitchen: Arc<Kitchen>,
    id: EnvironmentId,
    seed: u64,
    settings: EpisodeConfig,
    carried_goal: CarriedGoal,
    substeps: u32,
    // The number that state hashes have.
    hashed_number: u32,
    episode: Episode,
    target: usize,
    simulation: Simulation,
    // Position of every movable thing at step 0.
    origins: Vec<Vec3>,
    step: u32,
    previous_action: Option<Action>,
    end: Option<End>,
    // Distances after the last step; none before the first, whose progress is 0 by definition.
    distances: Option<Distances>,
    displacement: Displacement,
    // Which movable things have been disturbed at some step of this episode.
    ever_disturbed: Vec<bool>,
    peak_disturbance_m: f64,
    peak_farthest_m: f32,
    // The revision of the things' poses that the disturbance was counted in.
    counted_revision: u32,
    // What the camera has seen stand still, and the bodies' poses of the last frame. Empty until the first.
    backdrop: Backdrop,
    world_from_bodies: Vec<Pose3>,
    // The start of an episode that may come next, in the making.
    ahead: Option<Box<Ahead>>,
    // An episode that is over, and whose memory was not yet given back.
    past: Option<Box<Simulation>>,
}

/// An episode's start in the making.
#[derive(Debug, Clone)]
struct Ahead {
    number: u32,
    episode: Episode,
    settling: Settling,
}

/// How far everything movable but the target is from where it stood at step 0.
#[derive(Debug, Clone, Copy, Default)]
struct Displacement {
    /// d: the sum, metres.
    total_m: f64,
    /// Things further than [`DISTURBED_AXIS_M`] away on some axis.
    disturbed: u32,
    /// The farthest, metres.
    farthest_m: f32,
}

#[derive(Debug, Clone, Copy)]
struct Distances {
    wrist_object_m: f32,
    object_goal_m: f32,
}

impl Environment {
    /// An environment at the start of its episode 0.
    pub fn new(kitchen: Arc<Kitchen>, id: EnvironmentId, config: &Config) -> Result<Self, EnvironmentError> {
        let episode = Episode::sample(&kitchen, &config.episode, config.seed, id, 0);
        Self::checked(kitchen, id, config, 0, episode)
    }

    /// An environment at the start of a given episode, if this is its kitchen.
    pub(crate) fn checked(
        kitchen: Arc<Kitchen>,
        id: EnvironmentId,
        config: &Config,
        episode_number: u32,
        episode: Episode,
    ) -> Result<Self, EnvironmentError> {
        if kitchen.id() == id.kitchen {
            Ok(Self::with_episode(kitchen, id, config, episode_number, episode))
        } else {
            Err(EnvironmentError::WrongKitchen { wanted: id.kitchen, given: kitchen.id() })
        }
    }

    /// An environment at the start of a given episode: evaluation and tests choose their own.
    pub fn with_episode(
        kitchen: Arc<Kitchen>,
        id: EnvironmentId,
        config: &Config,
        episode_number: u32,
        episode: Episode,
    ) -> Self {
        let simulation = begin(&kitchen, config.simulation.substeps, &episode).finish();
        let target = kitchen.target_movable(episode.category);
        let mut environment = Self {
            kitchen,
            id,
            seed: config.seed,
            settings: config.episode,
            carried_goal: config.network.carried_goal,
            substeps: config.simulation.substeps,
            hashed_number: episode_number,
            episode,
            target,
            simulation,
            origins: Vec::new(),
            step: 0,
            previous_action: None,
            end: None,
            distances: None,
            displacement: Displacement::default(),
            ever_disturbed: Vec::new(),
            peak_disturbance_m: 0.0,
            peak_farthest_m: 0.0,
            counted_revision: 0,
            backdrop: Backdrop::default(),
            world_from_bodies: Vec::new(),
            ahead: None,
            past: None,
        };
        environment.begin_counting();
        environment
    }

    /// Resets to the settled kitchen and samples the episode with this number.
    pub fn start_episode(&mut self, episode: u32) {
        self.begin_episode(episode, Episode::sample(&self.kitchen, &self.settings, self.seed, self.id, episode));
    }

    /// Resets to the settled kitchen and begins a given episode under this number.
    pub fn begin_episode(&mut self, number: u32, episode: Episode) {
        self.episode = episode;
        self.hashed_number = number;
        self.target = self.kitchen.target_movable(self.episode.category);
        match self.ahead.take().filter(|ahead| ahead.number == number && ahead.episode == self.episode) {
            Some(ahead) => {
                // Whoever prepares has time for that, too.
                let past = std::mem::replace(&mut self.simulation, ahead.settling.finish());
                self.past = Some(Box::new(past));
            }
            None => self.simulation = begin(&self.kitchen, self.substeps, &self.episode).finish(),
        }
        self.begin_counting();
    }

    /// Has this episode's state hashes have another number than the environment's own count of episodes.
    pub(crate) fn hash_as(&mut self, number: u32) {
        self.hashed_number = number;
    }

    /// Prepares the start of the episode that [`Environment::start_episode`] begins with this number, by a piece of work
    /// of about a quarter of a millisecond. Returns whether there is more to do. The episode is the same without it.
    pub fn prepare_episode(&mut self, number: u32) -> bool {
        self.prepare(number, |it| Episode::sample(&it.kitchen, &it.settings, it.seed, it.id, number))
    }

    /// The same for [`Environment::begin_episode`].
    pub fn prepare(&mut self, number: u32, episode: impl FnOnce(&Self) -> Episode) -> bool {
        if self.past.take().is_some() {
            return true;
        }
        match &mut self.ahead {
            Some(ahead) if ahead.number == number => !ahead.settling.advance(SUBSTEPS_AT_ONCE),
            _ => {
                let episode = episode(self);
                let settling = begin(&self.kitchen, self.substeps, &episode);
                self.ahead = Some(Box::new(Ahead { number, episode, settling }));
                true
            }
        }
    }

    /// Gives back the memory of the episode before, which [`Environment::prepare`] does, too.
    pub fn forget_past(&mut self) {
        self.past = None;
    }

    /// Starts the count at step 0: every later displacement counts.
    fn begin_counting(&mut self) {
        self.origins.clear();
        self.origins.extend(self.simulation.things().poses().iter().map(|pose| pose.translation));
        self.counted_revision = self.simulation.things().revision();
        self.step = 0;
        self.previous_action = None;
        self.end = None;
        self.distances = None;
        self.displacement = Displacement::default();
        self.ever_disturbed.clear();
        self.ever_disturbed.resize(self.origins.len(), false);
        self.peak_disturbance_m = 0.0;
        self.peak_farthest_m = 0.0;
    }

    /// Takes one action. It never resets the environment; [`Self::end`] shows when the episode has ended.
    ///
    /// # Panics
    /// If the episode has ended: the caller starts the next one first.
    pub fn step(&mut self, action: Action) -> Transition {
        assert!(!self.ended(), "the episode has ended: start the next one before the next action");
        let was_holding = self.simulation.holding();
        let succeeded = self.act(action);
        let holding = self.simulation.holding();
        let done = action == Action::DoneMidLevel;
        self.step += 1;
        self.previous_action = Some(action);
        self.end =
            if done { Some(End::Terminated) } else { (self.step >= self.settings.max_steps).then_some(End::Truncated) };

        let now = Distances {
            wrist_object_m: (self.simulation.wrist() - self.target_position()).length(),
            object_goal_m: (self.target_position() - self.episode.goal).length(),
        };
        let before = self.distances.replace(now).unwrap_or(now);
        let disturbance_before_m = self.displacement.total_m;
        let revision = self.simulation.things().revision();
        if std::mem::replace(&mut self.counted_revision, revision) != revision {
            self.displacement = self.measure_displacement();
        }
        let Displacement { total_m: disturbance_m, disturbed, farthest_m } = self.displacement;
        self.peak_disturbance_m = self.peak_disturbance_m.max(disturbance_m);
        self.peak_farthest_m = self.peak_farthest_m.max(farthest_m);
        let one_if = |condition: bool| f32::from(u8::from(condition));
        Transition {
            reward: RewardParts {
                wrist_object_progress_m: before.wrist_object_m - now.wrist_object_m,
                object_goal_progress_m: before.object_goal_m - now.object_goal_m,
                disturbance_progress_m: (disturbance_before_m - disturbance_m) as f32,
                failed_action: one_if(!succeeded),
                picked_up: one_if(holding && !was_holding),
                goal_success: one_if(done && succeeded),
            },
            disturbance_m: disturbance_m as f32,
            peak_disturbance_m: self.peak_disturbance_m as f32,
            wrist_object_m: now.wrist_object_m,
            object_goal_m: now.object_goal_m,
            disturbed_objects: disturbed,
            ever_disturbed_objects: self.ever_disturbed.iter().filter(|&&ever| ever).count() as u32,
            farthest_m,
            peak_farthest_m: self.peak_farthest_m,
            held: u32::from(holding),
            target: u32::from(self.episode.category.index()),
        }
    }

    /// What is seen now.
    pub fn current(&self) -> Current {
        let configuration = self.simulation.configuration();
        let (wrist, target, goal) = (self.simulation.wrist(), self.target_position(), self.episode.goal);
        let robot_from_world = rotation_y(-configuration.yaw_rad());
        let holding = self.simulation.holding();
        let wrist_to_object_m = (robot_from_world * (target - wrist)).to_array();
        let object_to_goal_m = (robot_from_world * (goal - target)).to_array();
        Current {
            goal_m: goal_m(self.carried_goal, holding, wrist_to_object_m, object_to_goal_m),
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

    /// Hash of everything that can be seen of the state: episode, step, every movable thing's pose, velocity and sleep
    /// flag (of one that is held its pose alone), the robot's configuration, and whether it holds the target. The
    /// solver's own memory (contacts, islands) is not in it; where that differs, a later hash does.
    pub fn state_hash(&self) -> u64 {
        let configuration = self.simulation.configuration();
        let things = self.simulation.things().hash();
        let [x, y, z] = configuration.wrist_ticks;
        let ticks = [
            configuration.yaw_ticks,
            configuration.look_ticks,
            configuration.height_ticks,
            x,
            y,
            z,
            configuration.elbow_ticks,
            configuration.wrist_yaw_ticks,
            configuration.wrist_pitch_ticks,
        ];
        let words = [self.hashed_number, self.step, things as u32, (things >> 32) as u32]
            .into_iter()
            .chain([configuration.x_m, configuration.z_m].map(f32::to_bits))
            .chain(ticks.map(i32::cast_unsigned))
            .chain([u32::from(self.simulation.holding())]);
        let mut bytes = [0; 4 * (4 + 2 + 9 + 1)];
        for (bytes, word) in bytes.chunks_exact_mut(4).zip(words) {
            bytes.copy_from_slice(&word.to_le_bytes());
        }
        xxh3_64(&bytes)
    }

    /// Renders what the head camera sees now into `depth_mm`: `side` × `side` pixels, row-major from the top left,
    /// depth along the camera's axis in millimetres, 0 where nothing is hit. The camera is made for this kitchen's
    /// bodies, and may serve all environments in it.
    ///
    /// # Panics
    /// If the frame has another size, or the camera was made for another number of bodies.
    pub fn look(&mut self, camera: &mut DepthCamera, side: usize, depth_mm: &mut [u16]) {
        let world_from_camera = self.place_bodies();
        camera.render_over(&mut self.backdrop, &self.world_from_bodies, world_from_camera, side, depth_mm);
    }

    /// The sums of the windows of that frame at its full size ([`proto::camera::sum_windows`]), without the frame.
    /// Returns false if they may not fit into 16 bits: then `sums_mm` holds anything.
    ///
    /// # Panics
    /// If the camera was made for another number of bodies.
    pub fn look_for_sums(&mut self, camera: &mut DepthCamera, sums_mm: &mut [u16; SUMS_PIXELS]) -> bool {
        let world_from_camera = self.place_bodies();
        camera.render_sums_over(&mut self.backdrop, &self.world_from_bodies, world_from_camera, sums_mm)
    }

    /// Notes where all bodies stand now, for the camera whose pose this returns.
    fn place_bodies(&mut self) -> Pose3 {
        let mut world_from_bodies = std::mem::take(&mut self.world_from_bodies);
        self.world_from_bodies(&mut world_from_bodies);
        self.world_from_bodies = world_from_bodies;
        self.world_from_camera()
    }

    /// Pose of the head camera: x right, y up, looks along +z.
    pub fn world_from_camera(&self) -> Pose3 {
        let configuration = self.simulation.configuration();
        world_from_camera(&configuration.posture(), configuration.camera_pitch_rad())
    }

    /// Pose of every body of [`Kitchen::bodies`], in order.
    pub fn world_from_bodies(&self, out: &mut Vec<Pose3>) {
        out.clear();
        out.extend_from_slice(&self.kitchen.settled_poses()[self.kitchen.static_bodies()]);
        out.extend_from_slice(self.simulation.things().poses());
        // The robot's body is not drawn: the camera sits inside it.
        out.extend_from_slice(&self.simulation.part_poses()[1..]);
    }

    pub fn kitchen(&self) -> &Arc<Kitchen> {
        &self.kitchen
    }

    /// The task.
    pub fn episode(&self) -> &Episode {
        &self.episode
    }

    /// Total displacement after the last step of everything movable but the target, metres.
    pub fn disturbance_m(&self) -> f32 {
        self.displacement.total_m as f32
    }

    /// How far each movable thing is from where it stood at step 0, metres, capped as in the sum; 0 of the target.
    pub fn displacements_m(&self) -> impl Iterator<Item = f32> + '_ {
        let poses = self.simulation.things().poses();
        self.origins.iter().zip(poses).enumerate().map(|(movable, (origin, pose))| {
            if movable == self.target { 0.0 } else { displacement_m(pose.translation - *origin) }
        })
    }

    /// Whether the episode has ended.
    pub fn ended(&self) -> bool {
        self.end.is_some()
    }

    /// How the episode has ended, if it has.
    pub fn end(&self) -> Option<End> {
        self.end
    }

    /// The last action of this episode; none before the first.
    pub fn previous_action(&self) -> Option<Action> {
        self.previous_action
    }

    /// Actions after which an episode ends at the latest.
    pub fn max_steps(&self) -> u32 {
        self.settings.max_steps
    }

    /// The robot's configuration.
    pub fn robot(&self) -> &Configuration {
        self.simulation.configuration()
    }

    /// Watches every sub-step of this episode from now on: see [`Simulation::extremes`].
    pub fn watch(&mut self) {
        self.simulation.watch();
    }

    /// The physics simulation, read-only.
    pub fn simulation(&self) -> &Simulation {
        &self.simulation
    }

    /// The robot's way since the last call, see [`Simulation::take_substeps`].
    pub fn take_substeps(&mut self) -> Vec<Substep> {
        self.simulation.take_substeps()
    }

    /// Carries an action out; whether it succeeded.
    fn act(&mut self, action: Action) -> bool {
        match action {
            Action::PickUpMidLevel => self.simulation.pick_up(self.target),
            Action::DoneMidLevel => {
                let holding = self.simulation.holding();
                self.simulation.idle();
                holding && at_goal(self.target_position(), self.episode.goal)
            }
            Action::LookUp | Action::LookDown => match self.simulation.configuration().after(action) {
                Some(next) => {
                    self.simulation.look(next);
                    true
                }
                None => self.stand_still(),
            },
            _ => match self.simulation.configuration().after(action) {
                Some(next) => self.simulation.perform(next),
                None => self.stand_still(),
            },
        }
    }

    fn target_position(&self) -> Vec3 {
        self.simulation.movable_pose(self.target).translation
    }

    fn stand_still(&mut self) -> bool {
        self.simulation.idle();
        false
    }

    /// Looks at all movable things but the target, and notes which are disturbed.
    fn measure_displacement(&mut self) -> Displacement {
        let mut displacement = Displacement::default();
        for (movable, (origin, pose)) in self.origins.iter().zip(self.simulation.things().poses()).enumerate() {
            if movable == self.target {
                continue;
            }
            let moved = pose.translation - *origin;
            assert!(moved.is_finite(), "a body's pose is not a number");
            let moved_m = displacement_m(moved);
            displacement.total_m += f64::from(moved_m);
            displacement.farthest_m = displacement.farthest_m.max(moved_m);
            if moved.abs().max_element() > DISTURBED_AXIS_M {
                displacement.disturbed += 1;
                self.ever_disturbed[movable] = true;
            }
        }
        displacement
    }
}

/// How far a thing that was moved like this is from where it stood, capped, metres.
fn displacement_m(moved: Vec3) -> f32 {
    moved.length().min(OBJECT_DISPLACEMENT_CAP_M)
}

fn begin(kitchen: &Arc<Kitchen>, substeps: u32, episode: &Episode) -> Settling {
    let Episode { category, start, stand, .. } = episode;
    let target = kitchen.target_movable(*category);
    let configuration = Configuration::start(stand.x_m, stand.z_m, stand.yaw_ticks);
    Settling::new(Arc::clone(kitchen), substeps, configuration, target, *start)
}

#[cfg(test)]
mod tests;
