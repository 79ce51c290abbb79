//! Episodes: target, start, goal, and the robot's start pose.
//!
//! In training a pure function of (run seed, kitchen, environment, episode number).

use crate::kitchen::Kitchen;
use crate::kitchen::spots::Stand;
use crate::robot::configuration::Configuration;
use crate::robot::links::part_poses;
use proto::config::EpisodeConfig;
use proto::episode::EnvironmentId;
use proto::kitchen::TargetCategory;
use proto::random::{Key, Purpose, Random};
use rapier3d::math::{Pose3, Vec3};
use rapier3d::parry::bounding_volume::BoundingVolume;

/// The target is at its goal when it is this near on each axis, metres (reference).
pub const GOAL_TOLERANCE_M: f32 = 0.1;
/// Draws of a pair of spots before the nearest admissible one is searched for.
const TRIES: u32 = 64;
/// Room between the robot's start pose and the target, metres.
const START_CLEARANCE_M: f32 = 0.02;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Episode {
    pub category: TargetCategory,
    pub start: Vec3,
    pub goal: Vec3,
    pub stand: Stand,
}

pub fn at_goal(target: Vec3, goal: Vec3) -> bool {
    (target - goal).abs().max_element() <= GOAL_TOLERANCE_M
}

impl Episode {
    /// The training episode with this number.
    pub fn sample(kitchen: &Kitchen, config: &EpisodeConfig, seed: u64, id: EnvironmentId, episode: u32) -> Self {
        let mut random = Key::episode(seed, Purpose::Episode, id.kitchen, id.number, episode).stream();
        let targets = kitchen.training_targets();
        let category = targets[random.below(targets.len() as u32) as usize];
        Self::about(kitchen, config, category, &mut random)
    }

    /// The episode of this category that comes out of `random`, within the distances of `config`. Panics if the kitchen
    /// has no such target.
    pub(crate) fn about(
        kitchen: &Kitchen,
        config: &EpisodeConfig,
        category: TargetCategory,
        random: &mut Random,
    ) -> Self {
        let spots = kitchen.target_spots(category);
        let start = spots[random.below(spots.len() as u32) as usize];
        let goal = goal(spots, start, config.goal_distance_max_m, random);
        let stand = stand(kitchen, category, start, config.start_distance_max_m, random);
        Self { category, start, goal, stand }
    }
}

/// A goal that is not reached from the start: within `distance_max_m` of it if that is not 0 and there is one.
fn goal(spots: &[Vec3], start: Vec3, distance_max_m: f32, random: &mut Random) -> Vec3 {
    let limit_m = if distance_max_m > 0.0 { distance_max_m } else { f32::INFINITY };
    for _ in 0..TRIES {
        let spot = spots[random.below(spots.len() as u32) as usize];
        if !at_goal(spot, start) && (spot - start).length() <= limit_m {
            return spot;
        }
    }
    // Rare: few spots lie within the limit. The nearest that is not already reached.
    let distance = |spot: &Vec3| (*spot - start).length();
    spots
        .iter()
        .filter(|spot| !at_goal(**spot, start))
        .min_by(|a, b| distance(a).total_cmp(&distance(b)))
        .copied()
        .unwrap_or(start)
}

/// A robot pose that does not touch the target: within `distance_max_m` of it on the floor plane if that is not 0,
/// or the nearest there is.
fn stand(kitchen: &Kitchen, category: TargetCategory, target: Vec3, distance_max_m: f32, random: &mut Random) -> Stand {
    let movable = kitchen.target_movable(category);
    let target_pose = Pose3::from_translation(target);
    let occupied = kitchen.solids[movable].aabb(&target_pose).loosened(START_CLEARANCE_M);
    let distance = |stand: &Stand| {
        let (x, z) = (stand.x_m - target.x, stand.z_m - target.z);
        f32::sqrt(x * x + z * z)
    };
    let clear = |stand: &Stand| {
        let configuration = Configuration::start(stand.x_m, stand.z_m, stand.yaw_ticks);
        part_poses(&configuration.posture()).is_ok_and(|poses| {
            kitchen.robot_parts.iter().zip(&poses).all(|(part, pose)| !part.aabb(pose).intersects(&occupied))
        })
    };
    let near: Vec<&Stand> = kitchen
        .robot_stands()
        .iter()
        .filter(|stand| distance_max_m <= 0.0 || distance(stand) <= distance_max_m)
        .collect();
    if !near.is_empty() {
        for _ in 0..TRIES {
            let candidate = near[random.below(near.len() as u32) as usize];
            if clear(candidate) {
                return *candidate;
            }
        }
    }
    // The nearest stand that is clear of the target, even if the target is out of the arm's reach. If no stand in the
    // room is clear, any is used: the target is then pushed aside while it settles.
    let stands = kitchen.robot_stands();
    stands
        .iter()
        .filter(|stand| clear(stand))
        .min_by(|a, b| distance(a).total_cmp(&distance(b)))
        .or(stands.first())
        .copied()
        .expect("a kitchen is only built with free floor for the robot")
}
