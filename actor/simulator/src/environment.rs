//! An environment as the actor process runs it, whatever the task; and what all environments in kitchens have in common.

use crate::depth::{Backdrop, DepthCamera};
use crate::kitchen::Kitchen;
use crate::robot::configuration::Configuration;
use crate::robot::links::world_from_camera;
use crate::simulation::{Settling, Simulation, Start, Substep, ThingMotion};
use proto::camera::SUMS_PIXELS;
use proto::config::Config;
use proto::record::End;
use proto::replay::Player;
use rapier3d::math::{Pose3, Vec3};
use std::any::Any;
use std::error::Error;
use std::sync::Arc;
use xxhash_rust::xxh3::xxh3_64;

/// An object that moved further than this on some axis is disturbed, metres (reference).
pub const DISTURBED_AXIS_M: f32 = 0.01;
/// Displacement of one object counts at most this much, metres.
const OBJECT_DISPLACEMENT_CAP_M: f32 = 10.0;

/// Sub-steps of one piece of work of [`Base::prepare`].
const SUBSTEPS_AT_ONCE: u32 = 8;

/// One environment of a task. The same configuration, environment, episode and actions give the same bits everywhere.
pub trait Environment: Any + Send + Sync {
    fn begin(&mut self, number: u32);

    /// Prepares that start, by a piece of work of about a quarter of a millisecond. Returns whether there is more to do.
    /// The episode is the same without it.
    fn prepare(&mut self, number: u32) -> bool;

    /// Takes one action and writes what it did: the bytes are those of a record's action, and of its parts and
    /// outcomes. It never resets the environment: [`Base::end`] shows when the episode has ended. Panics if the episode
    /// has ended, or the task has no such action.
    fn act(&mut self, action: &[u8], done: &mut [u8]);

    /// Writes what is known of the parts and outcomes before an episode's first action; nothing, unless a task says so.
    fn before_first(&self, _done: &mut [u8]) {}

    /// Writes what is seen now: these are the bytes of a record's observations and states, but for images.
    fn observe(&self, seen: &mut [u8]);

    fn base(&self) -> &Base;

    fn base_mut(&mut self) -> &mut Base;

    fn boxed(&self) -> Box<dyn Environment>;
}

impl Clone for Box<dyn Environment> {
    fn clone(&self) -> Self {
        (**self).boxed()
    }
}

impl Player for dyn Environment + '_ {
    fn act(&mut self, action: &[u8], done: &mut [u8]) -> Result<(), Box<dyn Error + Send + Sync>> {
        Environment::act(self, action, done);
        Ok(())
    }

    fn observe(&mut self, seen: &mut [u8]) {
        Environment::observe(self, seen);
    }

    fn state_hash(&self) -> u64 {
        self.base().state_hash()
    }

    fn end(&self) -> Option<End> {
        self.base().end()
    }
}

/// The kitchen during an episode: its simulation, what was disturbed in it, and what its camera has seen.
#[derive(Debug, Clone)]
pub struct Base {
    kitchen: Arc<Kitchen>,
    substeps: u32,
    max_steps: u32,
    // The number that state hashes have.
    hashed_number: u32,
    start: Start,
    pub(crate) simulation: Simulation,
    // Position of every movable thing at step 0.
    origins: Vec<Vec3>,
    step: u32,
    end: Option<End>,
    displacement: Displacement,
    // Which movable things have been disturbed at some step of this episode.
    ever_disturbed: Vec<bool>,
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

#[derive(Debug, Clone)]
struct Ahead {
    number: u32,
    start: Start,
    settling: Settling,
}

/// How far everything movable, but what was set down, is from where it stood at step 0.
#[derive(Debug, Clone, Copy, Default)]
pub struct Displacement {
    /// d: the sum, metres.
    pub total_m: f64,
    /// Things further than [`DISTURBED_AXIS_M`] away on some axis.
    pub disturbed: u32,
    pub farthest_m: f32,
}

impl Base {
    pub(crate) fn new(kitchen: Arc<Kitchen>, config: &Config, number: u32, start: Start) -> Self {
        let substeps = config.simulation.substeps;
        let simulation = Settling::new(Arc::clone(&kitchen), substeps, start).finish();
        let mut base = Self {
            kitchen,
            substeps,
            max_steps: config.episode.max_steps,
            hashed_number: number,
            start,
            simulation,
            origins: Vec::new(),
            step: 0,
            end: None,
            displacement: Displacement::default(),
            ever_disturbed: Vec::new(),
            counted_revision: 0,
            backdrop: Backdrop::default(),
            world_from_bodies: Vec::new(),
            ahead: None,
            past: None,
        };
        base.begin_counting();
        base
    }

    pub(crate) fn begin(&mut self, number: u32, start: Start) {
        (self.hashed_number, self.start) = (number, start);
        match self.ahead.take().filter(|ahead| ahead.number == number && ahead.start == start) {
            Some(ahead) => {
                // Whoever prepares has time for that, too.
                let past = std::mem::replace(&mut self.simulation, ahead.settling.finish());
                self.past = Some(Box::new(past));
            }
            None => self.simulation = Settling::new(Arc::clone(&self.kitchen), self.substeps, start).finish(),
        }
        self.begin_counting();
    }

    /// A piece of work of [`Environment::prepare`] for an episode of this number that starts so.
    pub(crate) fn prepare(&mut self, number: u32, start: impl FnOnce(&Kitchen) -> Start) -> bool {
        if self.past.take().is_some() {
            return true;
        }
        match &mut self.ahead {
            Some(ahead) if ahead.number == number => !ahead.settling.advance(SUBSTEPS_AT_ONCE),
            _ => {
                let start = start(&self.kitchen);
                let settling = Settling::new(Arc::clone(&self.kitchen), self.substeps, start);
                self.ahead = Some(Box::new(Ahead { number, start, settling }));
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
        self.end = None;
        self.displacement = Displacement::default();
        self.ever_disturbed.clear();
        self.ever_disturbed.resize(self.origins.len(), false);
    }

    /// Counts an action that was carried out, and what it displaced. `done`: it ends the episode. Returns the displacement
    /// before it, and now.
    pub(crate) fn count(&mut self, done: bool) -> [Displacement; 2] {
        self.step += 1;
        self.end = if done { Some(End::Terminated) } else { (self.step >= self.max_steps).then_some(End::Truncated) };
        let before = self.displacement;
        let revision = self.simulation.things().revision();
        if std::mem::replace(&mut self.counted_revision, revision) != revision {
            self.displacement = self.measure_displacement();
        }
        [before, self.displacement]
    }

    /// Hash of everything that can be seen of the state: episode, step, every movable thing's pose, velocity and sleep
    /// flag (of one that is held its pose alone), the robot's configuration, and whether it holds something. The
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
    /// bodies, and may serve all environments in it. Panics if the frame has another size, or the camera was made for
    /// another number of bodies.
    pub fn look(&mut self, camera: &mut DepthCamera, side: usize, depth_mm: &mut [u16]) {
        let world_from_camera = self.place_bodies();
        camera.render_over(&mut self.backdrop, &self.world_from_bodies, world_from_camera, side, depth_mm);
    }

    /// The sums of the windows of that frame at its full size ([`proto::camera::sum_windows`]), without the frame.
    /// Returns false if they may not fit into 16 bits: then `sums_mm` holds anything. Panics if the camera was made for
    /// another number of bodies.
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

    /// Total displacement after the last step of everything movable but what was set down, metres.
    pub fn disturbance_m(&self) -> f32 {
        self.displacement.total_m as f32
    }

    /// How far each movable thing is from where it stood at step 0, metres, capped as in the sum; 0 of what was set down.
    pub fn displacements_m(&self) -> impl Iterator<Item = f32> + '_ {
        let poses = self.simulation.things().poses();
        self.origins.iter().zip(poses).enumerate().map(|(movable, (origin, pose))| {
            if self.counts(movable) { displacement_m(pose.translation - *origin) } else { 0.0 }
        })
    }

    /// Things that were disturbed after some step of this episode so far.
    pub(crate) fn ever_disturbed(&self) -> u32 {
        self.ever_disturbed.iter().filter(|&&ever| ever).count() as u32
    }

    pub fn ended(&self) -> bool {
        self.end.is_some()
    }

    pub fn end(&self) -> Option<End> {
        self.end
    }

    /// Actions after which an episode ends at the latest.
    pub fn max_steps(&self) -> u32 {
        self.max_steps
    }

    pub fn robot(&self) -> &Configuration {
        self.simulation.configuration()
    }

    /// How things moved since the last call, see [`Simulation::take_motions`].
    pub fn take_motions(&mut self) -> Vec<ThingMotion> {
        self.simulation.take_motions()
    }

    pub fn simulation(&self) -> &Simulation {
        &self.simulation
    }

    /// The robot's way since the last call, see [`Simulation::take_substeps`].
    pub fn take_substeps(&mut self) -> Vec<Substep> {
        self.simulation.take_substeps()
    }

    /// Whether a thing's displacement counts.
    fn counts(&self, movable: usize) -> bool {
        self.start.set_down.is_none_or(|(target, _)| target != movable)
    }

    /// Looks at all movable things that count, and notes which are disturbed.
    fn measure_displacement(&mut self) -> Displacement {
        let mut displacement = Displacement::default();
        for (movable, (origin, pose)) in self.origins.iter().zip(self.simulation.things().poses()).enumerate() {
            if !self.counts(movable) {
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

#[cfg(test)]
mod tests;
