//! Random actions in a few kitchens, watched at every sub-step of physics. Nothing may tunnel, nothing may explode.

use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::kitchen::KitchenId;
use proto::random::{Key, Purpose};
use rapier3d::geometry::Aabb;
use rapier3d::math::Vec3;
use rapier3d::parry::bounding_volume::BoundingVolume;
use simulator::kitchen::Kitchen;
use simulator::robot::action::Action;
use simulator::tasks::arm_point_nav::{Environment, check};
use std::sync::Arc;

/// Extremes over some stretch of simulation.
#[derive(Debug, Default)]
struct Extremes {
    /// Fastest motion of a thing's origin between two sub-steps, or its velocity if that is more, metres per second.
    fastest_m_per_s: f32,
    /// Deepest that a thing stood in a fixed one, metres.
    deepest_in_fixed_m: f32,
    /// Things that left the room, counted once a sub-step.
    left_room: u32,
    not_finite: u32,
}

impl Extremes {
    /// Takes in what moved since the last call. `positions`: where all things were then, and are now.
    fn take(&mut self, environment: &mut Environment, room: &Aabb, timestep_s: f32, positions: &mut [Vec3]) {
        for motion in environment.take_motions() {
            let (position, velocity) = (motion.pose.translation, motion.velocity_m_per_s);
            if !(position.is_finite() && motion.pose.rotation.is_finite() && velocity.is_finite()) {
                self.not_finite += 1;
                continue;
            }
            let before = std::mem::replace(&mut positions[motion.movable], position);
            let speed = ((position - before).length() / timestep_s).max(velocity.length());
            self.fastest_m_per_s = self.fastest_m_per_s.max(speed);
            self.deepest_in_fixed_m = self.deepest_in_fixed_m.max(motion.depth_in_fixed_m);
            self.left_room += u32::from(!room.contains_local_point(position));
        }
    }
}

fn positions(environment: &Environment) -> Vec<Vec3> {
    environment.simulation().things().poses().iter().map(|pose| pose.translation).collect()
}

const SEED: u64 = 3;
const STEPS: u32 = 2000;
/// Nothing may be faster than this, metres per second. Velocities are held below it by [`simulator::physics::world`];
/// what passes it is a thing that was put somewhere else between two sub-steps.
const SPEED_LIMIT_M_PER_S: f32 = 10.0;
/// Nothing may stand this deep in a fixed thing, metres. Pressed by the robot, which nothing can hold back, things do
/// enter what is behind them until the motion is stopped for it.
const DEPTH_LIMIT_M: f32 = 0.05;
/// Things whose middle is this far behind a wall's back or below the floor have left the room, metres.
const LEFT_ROOM_M: f32 = 0.01;
/// An action is taken up to this many times on end: steps of which each undoes the last lead nowhere and touch little.
const REPEATS_MOST: u32 = 8;

#[test]
fn nothing_tunnels_and_nothing_explodes() {
    let mut config = Config { seed: SEED, ..Config::default() };
    // Near enough to the target for the arm to meet something.
    config.episode.start_distance_max_m = 0.8;
    let mut disturbing = 0;
    for number in [8, 12, 16, 20, 26] {
        let kitchen = Kitchen::build(KitchenId::new(number).unwrap(), &config.simulation).unwrap();
        let (extremes, steps) = soak(&Arc::new(kitchen), &config);
        assert!(extremes.fastest_m_per_s < SPEED_LIMIT_M_PER_S, "kitchen {number}: {extremes:?}");
        assert!(extremes.deepest_in_fixed_m < DEPTH_LIMIT_M, "kitchen {number}: {extremes:?}");
        assert_eq!((extremes.left_room, extremes.not_finite), (0, 0), "kitchen {number}: {extremes:?}");
        disturbing += steps;
    }
    assert!(disturbing > 50, "10,000 random actions moved something {disturbing} times: too few to tell");
}

/// Takes random actions in a kitchen: all but Done, which would only cut episodes short. Also counts the actions after
/// which some thing other than the target was further from its place than before, or nearer to it.
fn soak(kitchen: &Arc<Kitchen>, config: &Config) -> (Extremes, u32) {
    let id = EnvironmentId { kitchen: kitchen.id(), number: 0 };
    let mut environment = Environment::new(Arc::clone(kitchen), id, config).unwrap();
    let (room, timestep_s) = (kitchen.extent().loosened(LEFT_ROOM_M), config.simulation.timestep_s);
    // From here on motions are noted.
    environment.take_motions();
    let mut positions_before = positions(&environment);
    let lasting: Vec<Action> = Action::ALL.into_iter().filter(|&action| action != Action::DoneMidLevel).collect();
    let (mut extremes, mut disturbing) = (Extremes::default(), 0);
    let (mut episode, mut step) = (0, 0);
    let (mut action, mut repeats) = (Action::LookDown, 0);
    for _ in 0..STEPS {
        if repeats == 0 {
            let kitchen = id.kitchen.number();
            let key = Key { seed: SEED, purpose: Purpose::RandomPolicy, kitchen, environment: 0, episode, step };
            let mut random = key.stream();
            action = lasting[random.below(lasting.len() as u32) as usize];
            repeats = 1 + random.below(REPEATS_MOST);
        }
        repeats -= 1;
        let transition = environment.step(action);
        extremes.take(&mut environment, &room, timestep_s, &mut positions_before);
        check(config.spec(), &transition, &environment.current()).expect("a learner takes what a simulator reports");
        disturbing += u32::from(transition.disturbance_progress_m != 0.0);
        step += 1;
        if environment.ended() {
            (episode, step) = (episode + 1, 0);
            environment.start_episode(episode);
            environment.take_motions();
            positions_before = positions(&environment);
        }
    }
    (extremes, disturbing)
}
