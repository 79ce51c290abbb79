//! What an episode must satisfy.
//!
//! Resting places are tried in the physics, reach and paths by the planner of [`oracle`] among what is fixed. No
//! check depends on how well any policy, the oracle included, does in the episode.

use crate::parallel::in_parallel;
use proto::config::Config;
use rapier3d::math::Vec3;
use simulator::kitchen::Kitchen;
use simulator::robot::configuration::Configuration;
use simulator::simulation::{CONTACT_TOLERANCE_M, OTHERS_DRIFT_M, Settling, Simulation, Start};
use simulator::tasks::arm_point_nav::episode::{Episode, at_goal};
use simulator::tasks::arm_point_nav::oracle::{self, Leg};
use std::sync::Arc;

/// A target that is set down comes to rest within this distance, metres.
const REST_DRIFT_M: f32 = 0.01;
/// Least cosine of the angle by which it leans then: 3 degrees.
const UPRIGHT_COSINE: f32 = 0.998_6;

#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Problem {
    #[error("the start already lies within the goal's tolerance")]
    AlreadyThere,
    #[error("the target does not come to rest at {0}")]
    Restless(Vec3),
    #[error("the target set down at {0} comes to rest {1} m away")]
    Drifts(Vec3, f32),
    #[error("the target set down at {0} leans or falls")]
    Leans(Vec3),
    #[error("the target set down at {0} moves something else by {1} m")]
    Pushes(Vec3, f32),
    #[error("the robot's start pose is not free")]
    StartPose,
    #[error("the target at {0} cannot be reached")]
    TargetOutOfReach(Vec3),
    #[error("the goal at {0} cannot be reached with the target in hand")]
    GoalOutOfReach(Vec3),
}

impl Problem {
    pub fn kind(&self) -> &'static str {
        match self {
            Self::AlreadyThere => "already there",
            Self::Restless(_) => "restless",
            Self::Drifts(..) => "drifts",
            Self::Leans(_) => "leans",
            Self::Pushes(..) => "pushes",
            Self::StartPose => "start pose",
            Self::TargetOutOfReach(_) => "target out of reach",
            Self::GoalOutOfReach(_) => "goal out of reach",
        }
    }
}

pub fn check(kitchen: &Arc<Kitchen>, config: &Config, episode: &Episode) -> Result<(), Problem> {
    if at_goal(episode.start, episode.goal) {
        return Err(Problem::AlreadyThere);
    }
    let target = kitchen.target_movable(episode.category);
    let stand = episode.stand;
    let robot = Configuration::start(stand.x_m, stand.z_m, stand.yaw_ticks);
    let substeps = config.simulation.substeps;
    for place in [episode.start, episode.goal] {
        let start = Start { robot, set_down: Some((target, place)) };
        let simulation = Settling::new(Arc::clone(kitchen), substeps, start).finish();
        rests(kitchen, &simulation, target, place)?;
        if simulation.depth_in_fixed_m() > CONTACT_TOLERANCE_M {
            return Err(Problem::StartPose);
        }
    }
    if !oracle::start_is_free(kitchen, episode) {
        return Err(Problem::StartPose);
    }
    match oracle::first_obstructed_leg(kitchen, episode) {
        None => Ok(()),
        Some(Leg::ToTarget) => Err(Problem::TargetOutOfReach(episode.start)),
        Some(Leg::ToGoal) => Err(Problem::GoalOutOfReach(episode.goal)),
    }
}

pub fn verdicts(kitchen: &Arc<Kitchen>, config: &Config, episodes: &[Episode]) -> Vec<Result<(), Problem>> {
    in_parallel(episodes.len(), |index| check(kitchen, config, &episodes[index]))
}

/// Whether the target rests where it was set down and nothing else has moved.
fn rests(kitchen: &Kitchen, simulation: &Simulation, target: usize, place: Vec3) -> Result<(), Problem> {
    if !simulation.began_at_rest() {
        return Err(Problem::Restless(place));
    }
    let pose = simulation.movable_pose(target);
    let drift_m = (pose.translation - place).length();
    if drift_m > REST_DRIFT_M {
        return Err(Problem::Drifts(place, drift_m));
    }
    if (pose.rotation * Vec3::Y).y < UPRIGHT_COSINE {
        return Err(Problem::Leans(place));
    }
    let settled = &kitchen.settled_poses()[kitchen.static_bodies().end..];
    for movable in (0..simulation.movable_count()).filter(|&movable| movable != target) {
        let moved_m = (simulation.movable_pose(movable).translation - settled[movable].translation).length();
        if moved_m > OTHERS_DRIFT_M {
            return Err(Problem::Pushes(place, moved_m));
        }
    }
    Ok(())
}
