//! A moment of an episode, as pictures need it, and what the episode is about.

use rapier3d::math::{Pose3, Vec3};
use simulator::kitchen::Kitchen;
use simulator::robot::links::PartPoses;
use simulator::tasks::arm_point_nav::Environment;
use simulator::tasks::arm_point_nav::Transition;

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

impl Moment {
    /// The moment that an environment is in; `transition`: what led there, none at the start. Its words lack the
    /// number of the step and the episode's end.
    pub fn of(environment: &Environment, transition: Option<&Transition>) -> Self {
        let simulation = environment.simulation();
        Self {
            things: simulation.things().poses().to_vec(),
            robot: *simulation.part_poses(),
            world_from_camera: environment.world_from_camera(),
            words: words(environment, transition),
        }
    }

    /// Pose of every body that the depth camera sees, in the kitchen's order.
    pub fn world_from_bodies(&self, kitchen: &Kitchen, out: &mut Vec<Pose3>) {
        out.clear();
        out.extend_from_slice(&kitchen.settled_poses()[kitchen.static_bodies()]);
        out.extend_from_slice(&self.things);
        // The robot's body is not drawn: the camera sits inside it.
        out.extend_from_slice(&self.robot[1..]);
    }
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

/// Caption of a moment, without its number and the episode's end.
fn words(environment: &Environment, transition: Option<&Transition>) -> Words {
    let current = environment.current();
    let action = environment.previous_action();
    let remark = match transition {
        Some(transition) if transition.picked_up() => "picked up",
        Some(transition) if transition.failed() => "failed",
        _ => "",
    };
    let category = environment.episode().category.name();
    let target = if environment.simulation().holding() {
        format!("{category} in hand")
    } else {
        format!("{category} {:.2} m from the wrist", Vec3::from(current.wrist_to_object_m).length())
    };
    Words {
        action: action.map_or_else(String::new, |action| action.name().to_owned()),
        remark: remark.to_owned(),
        target,
        goal: format!("goal {:.2} m from the {category}", Vec3::from(current.object_to_goal_m).length()),
        disturbance: format!("disturbance {:.3} m", environment.disturbance_m()),
        outcome: None,
    }
}
