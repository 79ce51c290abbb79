//! Poses and motion of movable things as of the last synchronisation with the physics world, in one small place: most
//! steps touch nothing else, and an actor steps many environments in turn.

use super::geometry::Solid;
use super::world::World;
use rapier3d::dynamics::RigidBodyHandle;
use rapier3d::geometry::Aabb;
use rapier3d::math::{Pose3, Vec3};
use xxhash_rust::xxh3::xxh3_64;

/// Bytes of one thing in the hash: position, linear and angular velocity, rotation, and whether it sleeps.
const STATE_BYTES: usize = 4 * (3 + 3 + 3 + 4 + 1);

/// Poses, boxes and hash of all movable things.
#[derive(Debug, Clone)]
pub struct Things {
    poses: Vec<Pose3>,
    aabbs: Vec<Aabb>,
    states: Vec<u8>,
    hash: u64,
    revision: u32,
    /// Who moved since the last look.
    stale: Vec<u32>,
    is_stale: Vec<bool>,
}

impl Things {
    pub fn of(world: &World, handles: &[RigidBodyHandle], solids: &[Solid]) -> Self {
        let count = handles.len();
        let mut things = Self {
            poses: vec![Pose3::identity(); count],
            aabbs: vec![Aabb::new_invalid(); count],
            states: vec![0; count * STATE_BYTES],
            hash: 0,
            revision: 0,
            stale: (0..count as u32).collect(),
            is_stale: vec![true; count],
        };
        things.look(world, handles, solids);
        things
    }

    /// Notes that a thing moves: the next [`look`](Self::look) is at it too.
    pub fn disturb(&mut self, thing: usize) {
        if !std::mem::replace(&mut self.is_stale[thing], true) {
            self.stale.push(thing as u32);
        }
    }

    /// Looks at what moved since the last time.
    pub fn look(&mut self, world: &World, handles: &[RigidBodyHandle], solids: &[Solid]) {
        if self.stale.is_empty() {
            return;
        }
        let mut stale = std::mem::take(&mut self.stale);
        stale.retain(|&thing| {
            let index = thing as usize;
            let body = world.body(handles[index]);
            let asleep = body.is_sleeping();
            self.enter(index, body.position(), body.linvel(), body.angvel(), asleep, &solids[index]);
            // A thing that is awake can fall asleep without a further event.
            self.is_stale[index] = !asleep;
            !asleep
        });
        self.stale = stale;
        self.hash = xxh3_64(&self.states);
        self.revision = self.revision.wrapping_add(1);
    }

    /// Puts a thing that is carried where it is carried to. It does not move by itself: its own velocity is none.
    pub fn carry(&mut self, thing: usize, pose: &Pose3, solid: &Solid) {
        if std::mem::replace(&mut self.is_stale[thing], false) {
            self.stale.retain(|&other| other as usize != thing);
        }
        self.enter(thing, pose, Vec3::ZERO, Vec3::ZERO, true, solid);
        self.hash = xxh3_64(&self.states);
        self.revision = self.revision.wrapping_add(1);
    }

    fn enter(&mut self, thing: usize, pose: &Pose3, linear: Vec3, angular: Vec3, asleep: bool, solid: &Solid) {
        self.poses[thing] = *pose;
        self.aabbs[thing] = solid.aabb(pose);
        let vectors = [pose.translation, linear, angular].into_iter().flat_map(|vector| vector.to_array());
        let words = vectors.chain(pose.rotation.to_array()).map(f32::to_bits).chain([u32::from(asleep)]);
        let state = &mut self.states[thing * STATE_BYTES..(thing + 1) * STATE_BYTES];
        for (bytes, word) in state.chunks_exact_mut(4).zip(words) {
            bytes.copy_from_slice(&word.to_le_bytes());
        }
    }

    /// `world_from_body` of all things.
    pub fn poses(&self) -> &[Pose3] {
        &self.poses
    }

    pub fn aabbs(&self) -> &[Aabb] {
        &self.aabbs
    }

    /// Hash of all poses, velocities and sleep flags.
    pub fn hash(&self) -> u64 {
        self.hash
    }

    /// Changes whenever something has moved or come to rest.
    pub fn revision(&self) -> u32 {
        self.revision
    }
}
