//! How a furnished room becomes a kitchen: its physics world is built and comes to rest, then the places are found
//! where episodes can begin and end.

use super::body::{Body, BodyRole, number_names};
use super::reach::Reach;
use super::room::{Room, Surface, Thing};
use super::settled::{Kitchen, Matter, Target};
use super::spots::{self, Stand, Stands};
use crate::physics::fixed_scene::FixedScene;
use crate::physics::geometry::Solid;
use crate::physics::things::Things;
use crate::physics::world::World;
use crate::robot::links::{LINK_NAMES, PART_COUNT, part_shapes};
use proto::kitchen::{KitchenId, TargetCategory};
use rapier3d::dynamics::RigidBodyHandle;
use rapier3d::geometry::Aabb;
use rapier3d::math::{Pose3, Vec3};
use std::convert::Infallible;

/// Simulated time within which a kitchen comes to rest, seconds.
const SETTLE_LIMIT_S: f32 = 4.0;
/// A thing that settles further than this from where it was set down has fallen over, metres.
const SETTLE_DRIFT_M: f32 = 0.02;
/// The robot waits here, below the floor, until an episode places it.
const PARKED: Vec3 = Vec3::new(0.0, -20.0, 0.0);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Demands {
    /// Whether all twelve target categories must be there.
    pub every_target: bool,
    pub spots: usize,
    pub stands: usize,
}

#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Flaw {
    #[error("setting down thing {thing} (moved {moved_m:.3} m)")]
    Fell { thing: usize, moved_m: f32 },
    #[error("thing {thing}, which does not come to rest")]
    Awake { thing: usize },
    #[error("free floor ({stands} robot poses)")]
    Stands { stands: usize },
    #[error("surfaces within reach")]
    Unreachable,
    #[error("{}, which is not there", .category.name())]
    Target { category: TargetCategory },
    #[error("{spots} spots for {}", .category.name())]
    Spots { category: TargetCategory, spots: usize },
}

struct Rested {
    world: World,
    scene: FixedScene,
    bodies: Vec<Body>,
    static_count: usize,
    poses: Vec<Pose3>,
    movables: Vec<RigidBodyHandle>,
    robot: [RigidBodyHandle; PART_COUNT],
    robot_parts: [Solid; PART_COUNT],
    things: Vec<Thing>,
    surfaces: Vec<Surface>,
    floor: (Vec3, Vec3),
}

/// Where episodes can take place.
struct Found {
    stands: Vec<Stand>,
    targets: Vec<Option<Target>>,
    connected_share: f32,
}

impl Kitchen {
    /// Builds a room's physics world, lets it come to rest, and finds where episodes can take place in it. The error
    /// says what is wrong with the room; it is never empty.
    pub(crate) fn assemble(id: KitchenId, timestep_s: f32, room: Room, demands: &Demands) -> Result<Self, Vec<Flaw>> {
        Rested::of(room, timestep_s)?.open(id, |rested, solids| rested.find(solids, demands))
    }

    /// Builds the physics world of a room that has come to rest before, with the places that were found in it then:
    /// robot poses, and those of each target. Things may creep by a hair's breadth until their contacts bear them again.
    pub(super) fn reassemble(
        id: KitchenId,
        timestep_s: f32,
        room: Room,
        connected_share: f32,
        found: impl FnOnce(&[Surface], (Vec3, Vec3), &[Solid], &[Body]) -> (Vec<Stand>, Vec<Option<Target>>),
    ) -> Self {
        let mut rested = Rested::set_down(room, timestep_s);
        rested.world.run_until_asleep(&rested.movables, (SETTLE_LIMIT_S / timestep_s) as u32);
        rested.world.put_to_sleep(&rested.movables);
        rested.look();
        let opened = rested.open(id, |rested, solids| {
            let movables = &rested.bodies[rested.static_count..];
            let (stands, targets) = found(&rested.surfaces, rested.floor, solids, movables);
            Ok::<_, Infallible>(Found { stands, targets, connected_share })
        });
        let Ok(kitchen) = opened;
        kitchen
    }
}

impl Rested {
    /// Where episodes can take place, or what is wrong with the room.
    fn find(&self, solids: &[Solid], demands: &Demands) -> Result<Found, Vec<Flaw>> {
        let Self { scene, bodies, static_count, poses, robot_parts, surfaces, floor, .. } = self;
        let settled = &poses[*static_count..static_count + solids.len()];
        let aabbs: Vec<Aabb> = solids.iter().zip(settled).map(|(solid, pose)| solid.aabb(pose)).collect();
        let Stands { poses: stands, floor: free_floor, connected_share } =
            spots::stands(*floor, scene, &aabbs, robot_parts);
        if stands.len() < demands.stands {
            return Err(vec![Flaw::Stands { stands: stands.len() }]);
        }
        let points = spots::reachable_points(surfaces, &Reach::new(&free_floor, scene, robot_parts));
        let points = Some(points).filter(|points| !points.is_empty()).ok_or_else(|| vec![Flaw::Unreachable])?;
        let mut flaws = Vec::new();
        let mut targets = Vec::new();
        for category in TargetCategory::ALL {
            let Some(movable) = bodies[*static_count..].iter().position(|body| body.category == category.name()) else {
                if demands.every_target {
                    flaws.push(Flaw::Target { category });
                }
                targets.push(None);
                continue;
            };
            let others: Vec<(&Solid, &Pose3)> = solids
                .iter()
                .zip(settled)
                .enumerate()
                .filter(|&(index, _)| index != movable)
                .map(|(_, other)| other)
                .collect();
            let spots = spots::target_spots(&solids[movable], &points, scene, &others);
            if spots.len() < demands.spots {
                flaws.push(Flaw::Spots { category, spots: spots.len() });
            }
            targets.push(Some(Target { movable, spots }));
        }
        if !flaws.is_empty() {
            return Err(flaws);
        }
        Ok(Found { stands, targets, connected_share })
    }

    /// The kitchen that it is, with the places that `find` finds.
    fn open<E>(mut self, id: KitchenId, find: impl FnOnce(&Self, &[Solid]) -> Result<Found, E>) -> Result<Kitchen, E> {
        let things = std::mem::take(&mut self.things);
        let matter = things.iter().map(|&Thing { mass_kg, friction, .. }| Matter { mass_kg, friction }).collect();
        let solids: Vec<Solid> = things.into_iter().map(|thing| thing.solid).collect();
        let Found { stands, targets, connected_share } = find(&self, &solids)?;
        let Self { world, scene, bodies, static_count, poses, movables, robot, robot_parts, surfaces, floor, .. } =
            self;
        let things = Things::of(&world, &movables, &solids);
        Ok(Kitchen {
            id,
            bodies,
            static_count,
            settled_poses: poses,
            world,
            scene,
            movables,
            solids,
            things,
            robot,
            robot_parts,
            targets,
            stands,
            matter,
            connected_share,
            plan: None,
            kept_clear: Vec::new(),
            surfaces,
            floor,
            attempt: 0,
        })
    }

    /// Sets everything down and waits until it sleeps. The error is what did not stay, or does not come to rest.
    fn of(room: Room, timestep_s: f32) -> Result<Self, Vec<Flaw>> {
        let mut rested = Self::set_down(room, timestep_s);
        // Reported one by one before the rest is put to sleep, so that the author of a scene can fix it.
        rested.world.run_until_asleep(&rested.movables, (SETTLE_LIMIT_S / timestep_s) as u32);
        let awake: Vec<bool> = rested.movables.iter().map(|&handle| !rested.world.body(handle).is_sleeping()).collect();
        rested.world.put_to_sleep(&rested.movables);
        rested.look();
        let mut flaws = Vec::new();
        for (index, (thing, settled)) in rested.things.iter().zip(&rested.poses[rested.static_count..]).enumerate() {
            let moved_m = (settled.translation - thing.pose.translation).length();
            if moved_m.is_nan() || moved_m >= SETTLE_DRIFT_M {
                flaws.push(Flaw::Fell { thing: index, moved_m });
            } else if awake[index] {
                flaws.push(Flaw::Awake { thing: index });
            }
        }
        if flaws.is_empty() { Ok(rested) } else { Err(flaws) }
    }

    /// Puts everything where the room has it. Nothing has moved yet.
    fn set_down(room: Room, timestep_s: f32) -> Self {
        let Room { fixtures, things, surfaces, floor } = room;
        let mut scene = FixedScene::default();
        let mut world = World::new(timestep_s);
        let mut bodies = Vec::new();
        let mut poses = Vec::new();
        for fixture in fixtures {
            let solid = Solid::of(&fixture.shape);
            scene.add(&solid, &fixture.pose);
            world.add_fixed(&solid, fixture.pose);
            poses.push(fixture.pose);
            bodies.push(Body::of(&fixture.category, fixture.shape, BodyRole::Static));
        }
        let static_count = bodies.len();
        let movables: Vec<RigidBodyHandle> = things
            .iter()
            .map(|thing| world.add_movable(&thing.solid, thing.pose, thing.mass_kg, thing.friction))
            .collect();
        let robot_shapes = part_shapes();
        let robot_parts = robot_shapes.clone().map(|shape| Solid::of(&shape));
        let robot = robot_parts.each_ref().map(|part| world.add_kinematic(part, Pose3::from_translation(PARKED)));
        for thing in &things {
            bodies.push(Body::of(&thing.category, thing.shape.clone(), BodyRole::Movable));
            poses.push(thing.pose);
        }
        for (name, shape) in LINK_NAMES.iter().zip(robot_shapes.into_iter().skip(1)) {
            bodies.push(Body { name: (*name).into(), category: "Robot".into(), shape, role: BodyRole::Robot });
            poses.push(Pose3::from_translation(PARKED));
        }
        number_names(&mut bodies);
        Self { world, scene, bodies, static_count, poses, movables, robot, robot_parts, things, surfaces, floor }
    }

    fn look(&mut self) {
        for (pose, &handle) in self.poses[self.static_count..].iter_mut().zip(&self.movables) {
            *pose = *self.world.body(handle).position();
        }
    }
}
