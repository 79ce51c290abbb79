//! The rigid-body world: rapier's sets in one value that can be cloned, which is what a reset is.

use super::geometry::Solid;
use rapier3d::prelude::*;

const GRAVITY_M_PER_S2: f32 = 9.81;
/// rapier's default sleep thresholds keep a kitchen awake for 20 s; four times as much settles it within 0.6 s.
const SLEEP_THRESHOLD_FACTOR: f32 = 4.0;
/// A body that has been that slow for this long falls asleep, seconds.
const TIME_UNTIL_SLEEP_S: f32 = 0.25;
/// No body moves faster than this, metres per second: a fall from table height reaches 4.
const MAX_SPEED_M_PER_S: f32 = 5.0;
/// A moving body's contacts are foreseen this far ahead, metres: further than it comes in a sub-step of 1/60 s.
/// Together with rapier's sweep of fast bodies against fixed ones this keeps plates from falling through shelves, which
/// the sweep alone does not.
const FORESIGHT_M: f32 = 0.1;
/// Spin dies out at this rate (1/s). It stands for rolling friction, which rapier lacks.
const ANGULAR_DAMPING: f32 = 1.0;
/// Coulomb friction coefficient of fixed things and of the robot.
pub const FRICTION: f32 = 0.6;

pub struct World {
    parameters: IntegrationParameters,
    islands: IslandManager,
    broad_phase: BroadPhaseBvh,
    narrow_phase: NarrowPhase,
    bodies: RigidBodySet,
    colliders: ColliderSet,
    impulse_joints: ImpulseJointSet,
    multibody_joints: MultibodyJointSet,
    soft_bodies: SoftBodySet,
    movable_count: u128,
    /// Dynamic bodies that gravity acts on: all but those that sleep.
    weighed: Vec<RigidBodyHandle>,
    /// Whether a body was put elsewhere, woke or became another kind of body since the last sub-step.
    changed: bool,
    // Scratch, without meaning between calls.
    roused: Vec<RigidBodyHandle>,
    nothing: Nothing,
    // Work space only: a clone begins with fresh ones, so that nothing of an earlier episode can leak into the next.
    pipeline: PhysicsPipeline,
    ccd_solver: CCDSolver,
}

/// A world without colliders, see [`World::drive`].
#[derive(Default)]
struct Nothing {
    islands: IslandManager,
    broad_phase: BroadPhaseBvh,
    narrow_phase: NarrowPhase,
    colliders: ColliderSet,
    pipeline: CollisionPipeline,
}

impl std::fmt::Debug for World {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "World({} bodies, {} colliders)", self.bodies.len(), self.colliders.len())
    }
}

impl Clone for World {
    fn clone(&self) -> Self {
        Self {
            islands: self.islands.clone(),
            broad_phase: self.broad_phase.clone(),
            narrow_phase: self.narrow_phase.clone(),
            bodies: self.bodies.clone(),
            colliders: self.colliders.clone(),
            movable_count: self.movable_count,
            weighed: self.weighed.clone(),
            changed: self.changed,
            ..Self::new(self.parameters.dt)
        }
    }
}

impl World {
    pub fn new(timestep_s: f32) -> Self {
        let parameters = IntegrationParameters {
            dt: timestep_s,
            normalized_max_linear_velocity: MAX_SPEED_M_PER_S,
            ..IntegrationParameters::default()
        };
        Self {
            parameters,
            islands: IslandManager::new(),
            broad_phase: BroadPhaseBvh::new(),
            narrow_phase: NarrowPhase::new(),
            bodies: RigidBodySet::new(),
            colliders: ColliderSet::new(),
            impulse_joints: ImpulseJointSet::new(),
            multibody_joints: MultibodyJointSet::new(),
            soft_bodies: SoftBodySet::new(),
            movable_count: 0,
            weighed: Vec::new(),
            changed: true,
            roused: Vec::new(),
            nothing: Nothing::default(),
            pipeline: PhysicsPipeline::new(),
            ccd_solver: CCDSolver::new(),
        }
    }

    pub(crate) fn add_fixed(&mut self, solid: &Solid, pose: Pose3) -> RigidBodyHandle {
        let handle = self.bodies.insert(RigidBodyBuilder::fixed().pose(pose));
        self.add_colliders(handle, solid, None, FRICTION);
        handle
    }

    /// Adds a dynamic body of this mass, spread over its parts by volume, and Coulomb friction coefficient. Dynamic
    /// bodies are numbered in the order in which they are added.
    pub(crate) fn add_movable(&mut self, solid: &Solid, pose: Pose3, mass_kg: f32, friction: f32) -> RigidBodyHandle {
        let mut body = RigidBodyBuilder::dynamic()
            .pose(pose)
            .angular_damping(ANGULAR_DAMPING)
            .soft_ccd_prediction(FORESIGHT_M)
            .build();
        let activation = body.activation_mut();
        activation.normalized_linear_threshold *= SLEEP_THRESHOLD_FACTOR;
        activation.angular_threshold *= SLEEP_THRESHOLD_FACTOR;
        activation.time_until_sleep = TIME_UNTIL_SLEEP_S;
        body.user_data = self.movable_count;
        self.movable_count += 1;
        let handle = self.bodies.insert(body);
        self.weighed.push(handle);
        self.add_colliders(handle, solid, Some(mass_kg), friction);
        handle
    }

    pub(crate) fn add_kinematic(&mut self, solid: &Solid, pose: Pose3) -> RigidBodyHandle {
        let handle = self.bodies.insert(RigidBodyBuilder::kinematic_position_based().pose(pose));
        self.add_colliders(handle, solid, None, FRICTION);
        handle
    }

    fn add_colliders(&mut self, body: RigidBodyHandle, solid: &Solid, mass_kg: Option<f32>, friction: f32) {
        let volumes = solid.volumes_m3();
        let total: f32 = volumes.iter().sum();
        self.changed = true;
        for (index, ((shape, body_from_part), volume)) in solid.parts.iter().zip(volumes).enumerate() {
            let mut collider = ColliderBuilder::new(shape.clone()).position(*body_from_part).friction(friction);
            if let Some(mass_kg) = mass_kg {
                let share_kg = mass_kg * volume / total;
                collider = match solid.given_mass(index) {
                    None => collider.mass(share_kg),
                    Some(given) if volume > 0.0 => {
                        let mut mass = given;
                        mass.set_mass(share_kg, true);
                        collider.mass_properties(mass)
                    }
                    Some(nothing) => collider.mass_properties(nothing),
                };
            }
            self.colliders.insert_with_parent(collider, body, &mut self.bodies);
        }
    }

    pub fn step(&mut self) {
        self.pipeline.step(
            Vec3::new(0.0, -GRAVITY_M_PER_S2, 0.0),
            &self.parameters,
            &mut self.islands,
            &mut self.broad_phase,
            &mut self.narrow_phase,
            &mut self.bodies,
            &mut self.colliders,
            &mut self.impulse_joints,
            &mut self.multibody_joints,
            &mut self.soft_bodies,
            &mut self.ccd_solver,
            &(),
            &(),
        );
        self.changed = false;
        self.weigh();
    }

    /// Says where kinematic bodies go in the next sub-step.
    ///
    /// rapier 0.36 takes each body of which it has lent a mutable reference for one that was changed, and then measures
    /// every fixed collider again before it sweeps fast bodies: a tenth of a sub-step. A goal changes nothing unless it
    /// wakes its body. So the marks of these references are spent here, on a step among no colliders.
    pub(crate) fn drive(&mut self, goals: impl Iterator<Item = (RigidBodyHandle, Pose3)>) {
        for (handle, pose) in goals {
            let body = &mut self.bodies[handle];
            let slept = body.is_sleeping();
            body.set_next_kinematic_position(pose);
            self.changed |= slept != body.is_sleeping();
        }
        if !self.changed {
            let Nothing { islands, broad_phase, narrow_phase, colliders, pipeline } = &mut self.nothing;
            pipeline.step(0.0, islands, broad_phase, narrow_phase, &mut self.bodies, colliders, &(), &());
        }
    }

    /// Gravity acts on what is awake, and leaves alone what sleeps.
    ///
    /// rapier 0.36 wakes a touched body after it has chosen the contacts of the sub-step, so the solver does not yet
    /// have the contact between the woken body and its support. With gravity the body would fall 1.7 mm into its
    /// support (5/8 of g·dt²: four solver steps in a sub-step) and be pushed out up to a millimetre aside. Without
    /// gravity it stays in place until the contact exists.
    fn weigh(&mut self) {
        let bodies = &mut self.bodies;
        self.weighed.retain(|&handle| {
            let sleeps = bodies[handle].is_sleeping();
            if sleeps {
                bodies[handle].set_gravity_scale(0.0, false);
            }
            !sleeps
        });
        for handle in self.islands.active_bodies() {
            // Asked through a shared reference: a mutable one would mark the body as modified.
            let body = &self.bodies[handle];
            if body.is_dynamic() && !body.is_sleeping() && body.gravity_scale() == 0.0 {
                self.bodies[handle].set_gravity_scale(1.0, false);
                self.weighed.push(handle);
            }
        }
    }

    pub fn body(&self, handle: RigidBodyHandle) -> &RigidBody {
        &self.bodies[handle]
    }

    pub fn colliders(&self, handle: RigidBodyHandle) -> impl Iterator<Item = &Collider> {
        self.bodies[handle].colliders().iter().map(|&collider| &self.colliders[collider])
    }

    pub(crate) fn body_mut(&mut self, handle: RigidBodyHandle) -> &mut RigidBody {
        self.changed = true;
        &mut self.bodies[handle]
    }

    /// Puts a body somewhere else outright. It wakes up, unless it is kinematic, and so does what it was near to.
    pub fn put(&mut self, handle: RigidBodyHandle, pose: Pose3) {
        self.rouse_neighbours(handle);
        let wakes = self.bodies[handle].is_dynamic();
        self.body_mut(handle).set_position(pose, wakes);
    }

    /// Makes a movable body kinematic. Things near it wake up.
    pub(crate) fn take_hold(&mut self, handle: RigidBodyHandle) {
        self.rouse_neighbours(handle);
        let body = self.body_mut(handle);
        body.set_linvel(Vec3::ZERO, false);
        body.set_angvel(Vec3::ZERO, false);
        body.set_body_type(RigidBodyType::KinematicPositionBased, true);
    }

    /// Wakes what is near to a body that is about to be put elsewhere. The next sub-step would do so by itself, but
    /// from that it would learn of its weight a sub-step later than of what it stands on, see [`weigh`](Self::weigh).
    fn rouse_neighbours(&mut self, handle: RigidBodyHandle) {
        for &collider in self.bodies[handle].colliders() {
            for pair in self.narrow_phase.contact_pairs_with(collider) {
                let other = if pair.collider1 == collider { pair.collider2 } else { pair.collider1 };
                self.roused.extend(self.colliders[other].parent());
            }
        }
        for other in self.roused.drain(..) {
            self.islands.wake_up(&mut self.bodies, other, true);
        }
        self.weigh();
    }

    /// Numbers of the dynamic bodies that are awake.
    pub(crate) fn awake_movables(&self) -> impl Iterator<Item = usize> {
        self.islands
            .active_bodies()
            .map(|handle| &self.bodies[handle])
            .filter(|body| body.is_dynamic() && !body.is_sleeping())
            .map(|body| body.user_data as usize)
    }

    pub fn asleep(&self, handles: &[RigidBodyHandle]) -> bool {
        handles.iter().all(|&handle| self.bodies[handle].is_sleeping())
    }

    /// Steps until all these bodies sleep, at most `limit` times.
    pub(crate) fn run_until_asleep(&mut self, handles: &[RigidBodyHandle], limit: u32) {
        let mut steps = 0;
        while steps < limit && !self.asleep(handles) {
            self.step();
            steps += 1;
        }
    }

    /// Steps until all these bodies sleep, at most `limit` times; bodies that are still awake then are put to sleep
    /// where they are. Returns whether all came to rest by themselves.
    pub fn settle(&mut self, handles: &[RigidBodyHandle], limit: u32) -> bool {
        self.run_until_asleep(handles, limit);
        let rested = self.asleep(handles);
        self.put_to_sleep(handles);
        rested
    }

    /// Stops these bodies where they are.
    pub(crate) fn put_to_sleep(&mut self, handles: &[RigidBodyHandle]) {
        for &handle in handles {
            // Asked through a shared reference: a mutable one would mark the body as modified.
            let body = &self.bodies[handle];
            if !body.is_sleeping() || body.linvel() != Vec3::ZERO || body.angvel() != Vec3::ZERO {
                self.body_mut(handle).sleep();
            }
        }
        self.weigh();
    }

    /// Deepest penetration between a body and whatever it touches, fixed things included, metres; 0 if none.
    pub(crate) fn deepest_contact_m(&self, handle: RigidBodyHandle) -> f32 {
        let mut deepest = 0.0_f32;
        for &collider in self.bodies[handle].colliders() {
            for pair in self.narrow_phase.contact_pairs_with(collider) {
                for point in pair.manifolds().iter().flat_map(|manifold| &manifold.points) {
                    deepest = deepest.max(-point.dist);
                }
            }
        }
        deepest
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::physics::geometry::rotation_z;
    use crate::shape::{Primitive, Shape};

    fn cuboid(x_m: f32, y_m: f32, z_m: f32) -> Solid {
        Solid::of(&Shape::of(Primitive::Cuboid { half_extents_m: Vec3::new(x_m, y_m, z_m) }))
    }

    fn cylinder(radius_m: f32, half_height_m: f32) -> Solid {
        Solid::of(&Shape::of(Primitive::Cylinder { radius_m, half_height_m }))
    }

    /// Throws a thing at a board, 3 cm thick, that lies (down) or stands in its way. Whether it went through.
    fn goes_through(thing: &Solid, down: bool, away_m: f32, turn_rad: f32, speed_m_per_s: f32, spin: Vec3) -> bool {
        const HALF_THICKNESS_M: f32 = 0.015;
        let mut world = World::new(1.0 / 60.0);
        let direction = if down { Vec3::NEG_Y } else { Vec3::NEG_X };
        world.add_fixed(&cuboid(0.5, HALF_THICKNESS_M, 0.5), Pose3::translation(0.5, -HALF_THICKNESS_M, 0.0));
        world.add_fixed(&cuboid(HALF_THICKNESS_M, 1.0, 0.5), Pose3::translation(-HALF_THICKNESS_M, 1.0, 0.0));
        let aside = if down { Vec3::new(0.4, 0.0, 0.0) } else { Vec3::new(0.0, 0.3, 0.0) };
        let pose = Pose3::from_parts(aside - direction * away_m, rotation_z(turn_rad));
        let handle = world.add_movable(thing, pose, 0.1, 0.5);
        world.body_mut(handle).set_linvel(direction * speed_m_per_s, true);
        world.body_mut(handle).set_angvel(spin, true);
        (0..40).any(|_| {
            world.step();
            let place = world.body(handle).position().translation;
            let beside = place.x > 1.0 || place.z.abs() > 0.5;
            !beside && place.y.min(place.x) < -HALF_THICKNESS_M
        })
    }

    #[test]
    fn hardly_anything_goes_through_a_thin_board() {
        let things = [cuboid(0.1, 0.005, 0.01), cylinder(0.12, 0.01), cylinder(0.03, 0.05), cuboid(0.002, 0.1, 0.002)];
        let (mut throws, mut through) = (0, Vec::new());
        for (number, thing) in things.iter().enumerate() {
            // Distances that put the board at different places between two sub-steps.
            for away_m in (0..24u8).map(|k| 0.15 + 0.0037 * f32::from(k)) {
                for turn_rad in [0.0, 0.7, 1.57] {
                    for speed_m_per_s in [2.0, 4.0] {
                        for (down, spin) in [(true, 0.0), (false, 0.0), (true, 1.0), (false, 1.0)] {
                            throws += 1;
                            let spin = Vec3::new(3.0, 5.0, 7.0) * spin;
                            if goes_through(thing, down, away_m, turn_rad, speed_m_per_s, spin) {
                                through.push((number, down, away_m, turn_rad, speed_m_per_s, spin));
                            }
                        }
                    }
                }
            }
        }
        assert!(through.len() * 500 <= throws, "{} of {throws} went through: {through:?}", through.len());
    }

    #[test]
    fn no_body_is_faster_than_the_limit_nor_comes_further_than_is_foreseen() {
        const { assert!(MAX_SPEED_M_PER_S / 60.0 < FORESIGHT_M) };
        let mut world = World::new(1.0 / 60.0);
        let handle = world.add_movable(&cuboid(0.05, 0.05, 0.05), Pose3::translation(0.0, 50.0, 0.0), 1.0, 0.5);
        for _ in 0..120 {
            let before = world.body(handle).position().translation;
            world.step();
            let travel = (world.body(handle).position().translation - before).length();
            assert!(travel <= MAX_SPEED_M_PER_S / 60.0 + 1e-4);
        }
    }

    #[test]
    fn what_wakes_stays_where_it_stood() {
        // Once it fell through what it stood on by 1.7 mm in its first sub-step, because the solver did not know of
        // that yet, and was then pushed out and aside.
        let mut world = World::new(1.0 / 60.0);
        world.add_fixed(&cuboid(1.0, 0.05, 1.0), Pose3::translation(0.0, -0.05, 0.0));
        let hand = world.add_kinematic(&cuboid(0.02, 0.02, 0.02), Pose3::translation(0.2, 0.15, 0.2));
        let vase = world.add_movable(&cylinder(0.03, 0.1), Pose3::translation(0.0, 0.101, 0.0), 0.5, 0.6);
        let mug = world.add_movable(&cylinder(0.04, 0.05), Pose3::translation(0.6, 0.051, 0.0), 0.3, 0.6);
        let things = [vase, mug];
        assert!(world.settle(&things, 120));
        let stood = things.map(|thing| world.body(thing).position().translation);
        let moved_m = |world: &World, index: usize| {
            let now = world.body(things[index]).position().translation;
            (now - stood[index]).length()
        };
        // A hand comes to half a centimetre of the vase, near enough for a contact that is foreseen, and goes again.
        let mut woke = false;
        for k in (0..=10u8).chain((0..10).rev()) {
            let aside_m = 0.2 - 0.0155 * f32::from(k);
            world.body_mut(hand).set_next_kinematic_position(Pose3::translation(aside_m, 0.15, aside_m));
            world.step();
            woke |= !world.body(vase).is_sleeping();
            assert!(moved_m(&world, 0) < 1e-4, "the vase moved by {} m", moved_m(&world, 0));
        }
        assert!(woke, "the hand came near enough to wake the vase");
        // The mug is set down beside the vase, and later taken away.
        assert!(world.settle(&things, 120));
        for aside_m in [0.052, 0.6] {
            world.put(mug, Pose3::translation(aside_m, 0.051, aside_m));
            let mut woke = false;
            for _ in 0..60 {
                world.step();
                woke |= !world.body(vase).is_sleeping();
                assert!(moved_m(&world, 0) < 1e-4, "the vase moved by {} m", moved_m(&world, 0));
            }
            assert!(woke && world.asleep(&things));
            let fallen_m = 0.051 - world.body(mug).position().translation.y;
            assert!((0.0005..0.002).contains(&fallen_m), "it has its weight again: it came down by {fallen_m} m");
        }
    }

    #[test]
    fn what_stands_on_a_kinematic_body_falls_when_that_leaves() {
        let mut world = World::new(1.0 / 60.0);
        world.add_fixed(&cuboid(1.0, 0.05, 1.0), Pose3::translation(0.0, -0.05, 0.0));
        let hand = world.add_kinematic(&cuboid(0.1, 0.01, 0.1), Pose3::translation(0.0, 0.5, 0.0));
        let thing = world.add_movable(&cuboid(0.04, 0.04, 0.04), Pose3::translation(0.0, 0.551, 0.0), 0.5, 0.6);
        assert!(world.settle(&[thing], 120));
        assert_eq!(world.awake_movables().count(), 0);
        world.body_mut(hand).set_next_kinematic_position(Pose3::translation(0.0, 0.49, 0.0));
        world.step();
        assert_eq!(world.awake_movables().collect::<Vec<_>>(), [0]);
        // Gone, without another sub-step beside it.
        world.body_mut(hand).set_position(Pose3::translation(0.0, 0.5, 0.9), false);
        for _ in 0..60 {
            world.step();
        }
        assert!(world.body(thing).position().translation.y < 0.06);
    }
}
