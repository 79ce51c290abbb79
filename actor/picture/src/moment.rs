use rapier3d::math::{Pose3, Vec3};
use simulator::environment::DISTURBED_AXIS_M;
use simulator::kitchen::Kitchen;
use simulator::robot::links::PartPoses;
use simulator::simulation::Simulation;

const SAMPLES: usize = 12;
/// Weight of what has to be seen at the start: as much as most of the way.
const START: f32 = 20.0;
const SLACK_M: f32 = 0.1;
/// The way through the robot to its axis, from above.
const ROBOT_SLACK_M: f32 = 0.4;
/// Its head is this far above its middle, and its foot below, metres.
const STANDS_M: f32 = 0.8;
/// A thing that is nearer to its place than this stands still, metres.
const STILL_M: f32 = 0.005;

#[derive(Debug, Clone)]
pub struct Task {
    /// Place of the target among the kitchen's movable things, if there is one.
    pub target: Option<usize>,
    pub goal: Option<Vec3>,
    pub goal_tolerance_m: f32,
    pub title: String,
}

#[derive(Debug, Clone)]
pub struct Moment {
    pub things: Vec<Pose3>,
    pub robot: PartPoses,
    pub is_holding: bool,
    pub world_from_camera: Pose3,
    pub captions: Captions,
}

impl Moment {
    pub fn of(simulation: &Simulation, world_from_camera: Pose3, captions: Captions) -> Self {
        Self {
            things: simulation.things().poses().to_vec(),
            robot: *simulation.part_poses(),
            is_holding: simulation.holding(),
            world_from_camera,
            captions,
        }
    }

    pub fn world_from_bodies(&self, kitchen: &Kitchen, out: &mut Vec<Pose3>) {
        out.clear();
        out.extend_from_slice(&kitchen.settled_poses()[kitchen.static_bodies()]);
        out.extend_from_slice(&self.things);
        // The robot's body is not drawn: the camera sits inside it.
        out.extend_from_slice(&self.robot[1..]);
    }
}

#[derive(Debug, Clone, Default)]
pub struct Captions {
    pub action: String,
    /// What is to be noted of it, and whether the task rewards it: failed action, picked up.
    pub remarks: Vec<(String, bool)>,
    pub measures: String,
    /// How the episode ended, and its place among the task's successes, the most demanding first.
    pub outcome: Option<(String, Option<usize>)>,
}

/// Whether what was at the one place and is at the other counts as displaced.
pub fn is_displaced(from: Vec3, to: Vec3) -> bool {
    (to - from).abs().max_element() > DISTURBED_AXIS_M
}

/// The movable things that are not always where they are at first, and the target: pictures of the whole episode do not
/// show their shadows.
pub fn moving(task: &Task, moments: &[Moment]) -> Vec<usize> {
    let moves = |thing: usize| {
        let place = |moment: &Moment| moment.things[thing].translation;
        moments.iter().any(|moment| (place(moment) - place(&moments[0])).length() > STILL_M)
    };
    (0..moments[0].things.len()).filter(|&thing| Some(thing) == task.target || moves(thing)).collect()
}

/// A place that the outside view has to show. It counts as seen through what is less than `slack_m` before it: what it
/// stands on or in.
#[derive(Debug, Clone, Copy)]
pub struct Point {
    pub place: Vec3,
    pub weight: f32,
    pub slack_m: f32,
}

/// Start and goal of the target, the robot's start, everybody's way, and where it ends for what was displaced.
pub fn points(task: &Task, moments: &[Moment]) -> Vec<Point> {
    let point = |place: Vec3, weight: f32| Point { place, weight, slack_m: SLACK_M };
    // Its middle, its head and its foot, and where the arm's links end.
    let robot = |moment: &Moment, weight: f32| {
        let middle = moment.robot[0].translation;
        let body = [0.0, STANDS_M, -STANDS_M].map(|up| Point {
            place: middle + Vec3::new(0.0, up, 0.0),
            weight: weight / 3.0,
            slack_m: ROBOT_SLACK_M,
        });
        let arm = moment.robot.iter().skip(1).map(|link| point(link.translation, weight / 10.0));
        arm.chain(body).collect::<Vec<_>>()
    };
    let mut points: Vec<Point> = task.goal.map(|goal| point(goal, START)).into_iter().collect();
    let of_target = |moment: &Moment| task.target.map(|target| moment.things[target].translation);
    points.extend(of_target(&moments[0]).map(|start| point(start, START)));
    points.extend(robot(&moments[0], START));
    let place = |moment: &Moment, thing: usize| moment.things[thing].translation;
    let (first, last) = (&moments[0], &moments[moments.len() - 1]);
    let displaced =
        |&thing: &usize| Some(thing) != task.target && is_displaced(place(first, thing), place(last, thing));
    points.extend((0..last.things.len()).filter(displaced).map(|thing| point(place(last, thing), 3.0)));
    let step = moments.len().div_ceil(SAMPLES).max(1);
    // The last moment counts whatever the step.
    for moment in moments.iter().rev().step_by(step) {
        let hand = moment.robot[moment.robot.len() - 1].translation;
        points.extend(of_target(moment).map(|target| point(target, 1.0)));
        points.push(point(hand, 1.0));
        points.extend(robot(moment, 0.5));
    }
    points
}
