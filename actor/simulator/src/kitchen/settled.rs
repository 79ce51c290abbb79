//! A kitchen, settled and asleep: what every environment in it shares.

use super::body::Body;
use super::floor::Floor;
use super::ithor;
use super::layout::Plan;
use super::layout::floor_plan::Rectangle;
use super::room::Surface;
use super::spots::Stand;
use crate::physics::fixed_scene::FixedScene;
use crate::physics::geometry::Solid;
use crate::physics::things::Things;
use crate::physics::world::World;
use crate::robot::links::PART_COUNT;
use proto::kitchen::{KitchenId, TargetCategory};
use rapier3d::dynamics::RigidBodyHandle;
use rapier3d::geometry::Aabb;
use rapier3d::math::{Pose3, Vec3};
use rapier3d::parry::bounding_volume::BoundingVolume;
use std::ops::Range;

/// A kitchen, settled and asleep; immutable, shared between environments.
#[derive(Debug)]
pub struct Kitchen {
    pub(super) id: KitchenId,
    pub(super) bodies: Vec<Body>,
    pub(super) static_count: usize,
    pub(super) settled_poses: Vec<Pose3>,
    pub(crate) world: World,
    pub(crate) scene: FixedScene,
    pub(crate) movables: Vec<RigidBodyHandle>,
    pub(crate) solids: Vec<Solid>,
    pub(crate) things: Things,
    pub(crate) robot: [RigidBodyHandle; PART_COUNT],
    pub(crate) robot_parts: [Solid; PART_COUNT],
    pub(super) targets: Vec<Option<Target>>,
    pub(crate) stands: Vec<Stand>,
    pub(super) matter: Vec<Matter>,
    pub(super) connected_share: f32,
    pub(super) plan: Option<Plan>,
    pub(super) kept_clear: Vec<Rectangle>,
    pub(super) surfaces: Vec<Surface>,
    pub(super) floor: (Vec3, Vec3),
    pub(super) attempt: u32,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Matter {
    pub mass_kg: f32,
    pub friction: f32,
}

#[derive(Debug, Clone)]
pub(super) struct Target {
    /// Index among the movables.
    pub movable: usize,
    /// Where it can stand: positions of its origin.
    pub spots: Vec<Vec3>,
}

impl Kitchen {
    pub fn id(&self) -> KitchenId {
        self.id
    }

    /// All bodies: statics first, then movables, then the robot's links. An index into this list names a body
    /// everywhere.
    pub fn bodies(&self) -> &[Body] {
        &self.bodies
    }

    pub fn static_bodies(&self) -> Range<usize> {
        0..self.static_count
    }

    pub fn movable_bodies(&self) -> Range<usize> {
        self.static_count..self.static_count + self.movables.len()
    }

    /// `world_from_body` of every body in the settled state.
    pub fn settled_poses(&self) -> &[Pose3] {
        &self.settled_poses
    }

    pub fn surfaces(&self) -> &[Surface] {
        &self.surfaces
    }

    /// What a body is made of, by its index; none unless it is movable.
    pub fn matter(&self, body: usize) -> Option<Matter> {
        self.matter.get(body.checked_sub(self.static_count)?).copied()
    }

    /// Things as iTHOR counts them: everything but walls, ceiling and robot.
    pub fn thing_count(&self) -> usize {
        self.bodies.iter().filter(|body| !ithor::NOT_THINGS.contains(&body.category.as_str())).count()
    }

    /// Which of its draws it is, from 0: those before it had something wrong. 0 of a room that was not generated.
    pub fn attempt(&self) -> u32 {
        self.attempt
    }

    /// How its runs of counters lie; none for a room that was not generated.
    pub fn plan(&self) -> Option<Plan> {
        self.plan
    }

    /// Floor that is to stay free of fixtures: before fronts and the door. Empty for a room that was not generated.
    pub fn kept_clear(&self) -> &[Rectangle] {
        &self.kept_clear
    }

    /// Share of the free floor from which the robot can reach [`Kitchen::robot_stands`].
    pub fn connected_share(&self) -> f32 {
        self.connected_share
    }

    /// Positions at which a target of this category can stand, metres; none if the kitchen has no such thing.
    pub fn target_spots(&self, category: TargetCategory) -> &[Vec3] {
        self.targets[usize::from(category.index())].as_ref().map_or(&[], |target| &target.spots)
    }

    /// Categories that training episodes are about: the seen ones that are here, or, where there are none, whatever
    /// target there is.
    pub fn training_targets(&self) -> Vec<TargetCategory> {
        let here = |categories: &[TargetCategory]| -> Vec<TargetCategory> {
            categories
                .iter()
                .copied()
                .filter(|category| self.targets[usize::from(category.index())].is_some())
                .collect()
        };
        let seen = here(&TargetCategory::SEEN);
        if seen.is_empty() { here(&TargetCategory::ALL) } else { seen }
    }

    /// Index of a target among the movables. Panics if the kitchen has no such thing: episodes are about what is there.
    pub fn target_movable(&self, category: TargetCategory) -> usize {
        let target = self.targets[usize::from(category.index())].as_ref();
        target.expect("an episode's target is one of the kitchen's").movable
    }

    /// Robot poses at which an episode can begin.
    pub fn robot_stands(&self) -> &[Stand] {
        &self.stands
    }

    /// The floor that is free while everything stands where it settled.
    pub(crate) fn free_floor(&self) -> Floor {
        let poses = &self.settled_poses[self.movable_bodies()];
        let movables: Vec<Aabb> = self.solids.iter().zip(poses).map(|(solid, pose)| solid.aabb(pose)).collect();
        Floor::of(self.floor, &self.scene, &movables)
    }

    /// The settled physics world: episodes begin with copies of it.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// The rigid bodies of the movable things, in the order of [`Kitchen::movable_bodies`].
    pub fn movables(&self) -> &[RigidBodyHandle] {
        &self.movables
    }

    /// Collision geometry of the movable things, in the same order.
    pub fn solids(&self) -> &[Solid] {
        &self.solids
    }

    pub fn robot_parts(&self) -> &[Solid; PART_COUNT] {
        &self.robot_parts
    }

    /// The room up to the backs of its walls; where there are no walls, up to where fixed things end.
    pub fn extent(&self) -> Aabb {
        let mut room = Aabb::new_invalid();
        let bodies = || self.static_bodies().map(|index| (&self.bodies[index], &self.settled_poses[index]));
        let walled = bodies().any(|(body, _)| body.category == "Wall");
        for (body, pose) in bodies().filter(|(body, _)| !walled || body.category == "Wall") {
            room.merge(&Solid::of(&body.shape).aabb(pose));
        }
        room
    }
}
