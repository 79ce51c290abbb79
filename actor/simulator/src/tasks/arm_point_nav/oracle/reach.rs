//! The arm: from one configuration to another by steps of the wrist, the elbow and the arm's height.

use super::moment::Moment;
use super::search::{Graph, Search};
use super::space::Space;
use crate::physics::geometry::{Solid, rotation_y};
use crate::robot::action::Action;
use crate::robot::configuration::{ARM_HEIGHT_MAX_M, ARM_HEIGHT_MIN_M, ARM_HEIGHT_TICKS, Configuration, WRIST_STEP_M};
use crate::robot::dimensions::{ARM_BASE_AHEAD_M, MAGNET_RADIUS_M, REACH_M};
use crate::robot::links::{HAND, part_poses, world_from_robot};
use rapier3d::geometry::Aabb;
use rapier3d::math::{Pose3, Vec3};

/// The magnet reaches for the target with this much to spare, metres.
const MAGNET_SPARE_M: f32 = 0.006;
/// The target is brought to its goal with this much to spare on each axis, metres.
const GOAL_SPARE_M: f32 = 0.015;
/// Wrist positions this many steps about the expected one are looked at when something is to be brought somewhere.
const PLACE_STEPS: i32 = 3;
/// Final configurations that a search aims at.
const FINALS_MOST: usize = 8;
/// Final configurations that are tested.
const TESTS_MOST: usize = 400;
/// Configurations that a search of the arm expands.
const EXPANSIONS: u32 = 3000;
/// Turns of the elbow that are tried, in its own steps; upright first.
const ELBOWS: [&[i32]; 2] = [&[0], &[-6, 6, -3, 3]];
/// Actions of the arm that a search uses. Of two ways of the same length the one is taken whose first difference comes
/// earlier here: up before across before down, as a person takes a thing from a table.
const ACTIONS: [Action; 10] = [
    Action::MoveArmHeightP,
    Action::MoveArmYP,
    Action::MoveArmXP,
    Action::MoveArmXM,
    Action::MoveArmZP,
    Action::MoveArmZM,
    Action::RotateArmElbowP,
    Action::RotateArmElbowM,
    Action::MoveArmYM,
    Action::MoveArmHeightM,
];

/// What the arm is to do at the end of the way.
#[derive(Clone, Copy)]
pub enum Aim<'a> {
    /// Touch the target with the magnet.
    Grasp { solid: &'a Solid, pose: Pose3 },
    Place {
        /// The goal of its centre.
        goal: Vec3,
        /// Where it is against the wrist now, in the robot's axes.
        wrist_to_target: Vec3,
    },
}

impl<'a> Aim<'a> {
    pub fn of(moment: &Moment<'a>) -> Self {
        let Some(hand_from_body) = moment.held else {
            return Self::Grasp { solid: &moment.kitchen.solids()[moment.target], pose: moment.target_pose() };
        };
        let posture = moment.robot.posture();
        let wrist_to_target = part_poses(&posture).map_or(Vec3::ZERO, |poses| {
            let hand = poses[HAND];
            rotation_y(-posture.yaw_rad) * ((hand * hand_from_body).translation - hand.translation)
        });
        Self::Place { goal: moment.goal, wrist_to_target }
    }

    pub fn place(&self) -> Vec3 {
        match self {
            Self::Grasp { pose, .. } => pose.translation,
            Self::Place { goal, .. } => *goal,
        }
    }

    /// Room about the place within which the wrist must come, on the floor plane, metres.
    pub fn slack_m(&self) -> f32 {
        match self {
            Self::Grasp { solid, pose } => 0.5 * solid.aabb(pose).extents().with_y(0.0).length() + MAGNET_RADIUS_M,
            Self::Place { wrist_to_target, .. } => wrist_to_target.length() + 0.15,
        }
    }

    fn met_by(&self, space: &Space, configuration: &Configuration) -> bool {
        match self {
            // Known before the arm's joints are.
            Self::Grasp { .. } => true,
            Self::Place { goal, .. } => part_poses(&configuration.posture())
                .ok()
                .and_then(|poses| space.held_pose(&poses))
                .is_some_and(|pose| {
                    (pose.translation - *goal).abs().max_element()
                        <= crate::tasks::arm_point_nav::episode::GOAL_TOLERANCE_M - GOAL_SPARE_M
                }),
        }
    }
}

/// Configurations that meet the aim without driving and touch nothing, nearest first.
pub fn finals(space: &Space, at: &Configuration, aim: &Aim) -> Vec<Configuration> {
    for elbows in ELBOWS {
        let mut candidates = Vec::new();
        for &elbow_ticks in elbows {
            gather(at, elbow_ticks, aim, &mut candidates);
        }
        candidates.sort_by_key(|candidate| distance(at, candidate));
        let found: Vec<Configuration> = candidates
            .into_iter()
            .filter(|candidate| aim.met_by(space, candidate))
            .take(TESTS_MOST)
            .filter(|candidate| space.free(&candidate.posture()))
            .take(FINALS_MOST)
            .collect();
        if !found.is_empty() {
            return found;
        }
    }
    Vec::new()
}

fn gather(at: &Configuration, elbow_ticks: i32, aim: &Aim, out: &mut Vec<Configuration>) {
    let world_from_robot = world_from_robot(&at.posture());
    let middle = match aim {
        Aim::Grasp { pose, .. } => world_from_robot.inverse_transform_point(pose.translation),
        Aim::Place { goal, wrist_to_target } => world_from_robot.inverse_transform_point(*goal) - *wrist_to_target,
    };
    let bounds = match aim {
        Aim::Grasp { solid, pose } => solid.aabb(pose),
        Aim::Place { goal, .. } => Aabb::new(*goal, *goal),
    };
    let (horizontal_m, vertical_m) = match aim {
        Aim::Grasp { .. } => {
            let half = 0.5 * bounds.extents();
            (half.with_y(0.0).length() + MAGNET_RADIUS_M, half.y + MAGNET_RADIUS_M)
        }
        Aim::Place { .. } => (PLACE_STEPS as f32 * WRIST_STEP_M, 0.15),
    };
    let ticks = |middle_m: f32, half_m: f32| {
        let low = libm::ceilf((middle_m - half_m) / WRIST_STEP_M) as i32;
        let high = libm::floorf((middle_m + half_m) / WRIST_STEP_M) as i32;
        low..=high
    };
    for height_ticks in 0..=ARM_HEIGHT_TICKS {
        let share = height_ticks as f32 / ARM_HEIGHT_TICKS as f32;
        let shoulder_m = ARM_HEIGHT_MIN_M + share * (ARM_HEIGHT_MAX_M - ARM_HEIGHT_MIN_M);
        for y in ticks(middle.y - shoulder_m, vertical_m) {
            for x in ticks(middle.x, horizontal_m) {
                for z in ticks(middle.z - ARM_BASE_AHEAD_M, horizontal_m) {
                    let wrist = Vec3::new(x as f32, y as f32, z as f32) * WRIST_STEP_M;
                    if z < 0 || wrist.length() > REACH_M {
                        continue;
                    }
                    if let Aim::Grasp { solid, pose } = aim {
                        let point =
                            world_from_robot.transform_point(wrist + Vec3::new(0.0, shoulder_m, ARM_BASE_AHEAD_M));
                        let within_m = MAGNET_RADIUS_M - MAGNET_SPARE_M;
                        let outside = (point - point.clamp(bounds.mins, bounds.maxs)).length() > within_m;
                        if outside || solid.distance_to_point_m(pose, point) > within_m {
                            continue;
                        }
                    }
                    out.push(Configuration { height_ticks, wrist_ticks: [x, y, z], elbow_ticks, ..*at });
                }
            }
        }
    }
}

/// Actions of the arm between two configurations if nothing is in the way.
pub fn distance(from: &Configuration, to: &Configuration) -> u32 {
    let wrist: u32 = from.wrist_ticks.iter().zip(&to.wrist_ticks).map(|(a, b)| a.abs_diff(*b)).sum();
    wrist + from.height_ticks.abs_diff(to.height_ticks) + from.elbow_ticks.abs_diff(to.elbow_ticks)
}

struct Arm<'a> {
    space: &'a Space<'a>,
    finals: &'a [Configuration],
    forbidden: &'a [(Configuration, Action)],
}

impl Graph for Arm<'_> {
    type State = Configuration;

    fn key(&self, state: &Configuration) -> u64 {
        let [x, y, z] = state.wrist_ticks;
        [state.height_ticks, x, y, z, state.elbow_ticks]
            .into_iter()
            .fold(0, |key, ticks| key << 8 | u64::from((ticks + 64) as u8))
    }

    fn successors(&self, state: &Configuration, out: &mut Vec<(Action, Configuration)>) {
        out.extend(ACTIONS.iter().filter_map(|&action| state.after(action).map(|next| (action, next))));
    }

    fn passable(&self, from: &Configuration, action: Action, to: &Configuration) -> bool {
        !self.forbidden.contains(&(*from, action)) && self.space.passable(from, action, to)
    }

    fn bound(&self, state: &Configuration) -> u32 {
        self.finals.iter().map(|to| distance(state, to)).min().unwrap_or(0)
    }
}

/// The shortest way of the arm to one of the final configurations: the actions and where they end.
pub fn way(
    space: &Space,
    from: Configuration,
    finals: &[Configuration],
    forbidden: &[(Configuration, Action)],
) -> Option<(Vec<Action>, Configuration)> {
    if finals.is_empty() {
        return None;
    }
    let graph = Arm { space, finals, forbidden };
    let mut search = Search::new(&graph, from, EXPANSIONS);
    while let Some(index) = search.next(&graph) {
        if graph.bound(search.state(index)) == 0 {
            return Some((search.path(index), *search.state(index)));
        }
    }
    None
}
