//! A moment of an episode, as pictures need it, and what the episode is about.

use rapier3d::math::{Pose3, Vec3};
use simulator::robot::links::PartPoses;

/// Moments whose places the outside camera is chosen for.
const SAMPLES: usize = 12;

/// What an episode is about, as far as pictures of it go.
#[derive(Debug, Clone)]
pub struct Task {
    /// Place of the target among the kitchen's movable things.
    pub target: usize,
    /// Where it is to be brought, metres.
    pub goal: Vec3,
    /// Which episode, and what is to be brought.
    pub title: String,
}

/// One moment of an episode.
#[derive(Debug, Clone)]
pub struct Moment {
    /// Poses of the kitchen's movable things.
    pub things: Vec<Pose3>,
    /// Poses of the robot's parts.
    pub robot: PartPoses,
    /// Pose of the head camera.
    pub world_from_camera: Pose3,
    /// What happens.
    pub words: Words,
}

/// What is said below the title.
#[derive(Debug, Clone, Default)]
pub struct Words {
    /// The step, and the action that led here.
    pub action: String,
    /// What is to be noted of it: failed, picked up.
    pub remark: String,
    /// How far the wrist is from the target, or that it is held.
    pub target: String,
    /// How far the target is from the goal.
    pub goal: String,
    /// What was disturbed.
    pub disturbance: String,
    /// How the episode ended, and whether well; none before its last moment.
    pub outcome: Option<(String, bool)>,
}

/// What the outside view has to show, each point with its weight: start and goal of the target, and everybody's way.
/// The robot's body is in the picture, but large enough to be seen behind whatever there is.
pub fn points(task: &Task, moments: &[Moment]) -> Vec<(Vec3, f32)> {
    let mut points = vec![(task.goal, 3.0), (moments[0].things[task.target].translation, 3.0)];
    let step = moments.len().div_ceil(SAMPLES).max(1);
    // The last moment counts whatever the step.
    for moment in moments.iter().rev().step_by(step) {
        let [body, .., hand] = moment.robot.map(|pose| pose.translation);
        points.extend([(moment.things[task.target].translation, 1.0), (hand, 1.0), (body, 0.0)]);
    }
    points
}
