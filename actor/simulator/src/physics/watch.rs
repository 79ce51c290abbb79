//! Extremes of the physics, checked at every sub-step: speed, penetration, distance outside the room.

use super::fixed_scene::FixedScene;
use super::geometry::Solid;
use rapier3d::geometry::Aabb;
use rapier3d::math::{Pose3, Vec3};
use rapier3d::parry::bounding_volume::BoundingVolume;

/// Things whose middle is this far behind a wall's back or below the floor have left the room, metres.
const LEFT_ROOM_M: f32 = 0.01;

/// Extremes over some stretch of simulation.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Extremes {
    /// Sub-steps in which physics was at work.
    pub substeps: u64,
    /// Fastest motion of a thing's origin between two sub-steps, or its velocity if that is more, metres per second.
    pub fastest_m_per_s: f32,
    /// Deepest that a thing stood in a fixed one, metres.
    pub deepest_in_fixed_m: f32,
    /// Things that left the room, counted once an episode.
    pub left_room: u32,
    pub not_finite: u32,
}

impl Extremes {
    /// The worse of both; counts are added.
    pub fn merge(&mut self, other: &Self) {
        self.substeps += other.substeps;
        self.fastest_m_per_s = self.fastest_m_per_s.max(other.fastest_m_per_s);
        self.deepest_in_fixed_m = self.deepest_in_fixed_m.max(other.deepest_in_fixed_m);
        self.left_room += other.left_room;
        self.not_finite += other.not_finite;
    }
}

#[derive(Debug, Clone)]
pub(crate) struct Watch {
    room: Aabb,
    timestep_s: f32,
    positions: Vec<Vec3>,
    outside: Vec<bool>,
    extremes: Extremes,
}

impl Watch {
    pub fn new(room: Aabb, timestep_s: f32, poses: &[Pose3]) -> Self {
        Self {
            room: room.loosened(LEFT_ROOM_M),
            timestep_s,
            positions: poses.iter().map(|pose| pose.translation).collect(),
            outside: vec![false; poses.len()],
            extremes: Extremes::default(),
        }
    }

    pub(crate) fn count_substep(&mut self) {
        self.extremes.substeps += 1;
    }

    /// A thing after a sub-step, which it spent awake, among what is fixed.
    pub(crate) fn note(&mut self, fixed: &FixedScene, thing: usize, solid: &Solid, pose: &Pose3, velocity: Vec3) {
        let position = pose.translation;
        if !(position.is_finite() && pose.rotation.is_finite() && velocity.is_finite()) {
            self.extremes.not_finite += 1;
            return;
        }
        let before = std::mem::replace(&mut self.positions[thing], position);
        let speed = ((position - before).length() / self.timestep_s).max(velocity.length());
        self.extremes.fastest_m_per_s = self.extremes.fastest_m_per_s.max(speed);
        let depth_m = fixed.deepest_penetration_m(solid, pose);
        self.extremes.deepest_in_fixed_m = self.extremes.deepest_in_fixed_m.max(depth_m);
        if !self.room.contains_local_point(position) && !std::mem::replace(&mut self.outside[thing], true) {
            self.extremes.left_room += 1;
        }
    }

    pub fn extremes(&self) -> &Extremes {
        &self.extremes
    }
}
