//! The floor: where the robot can drive with its arm held still.
//!
//! Turns of 45 degrees and ways of 0.2 m reach ever new positions; positions in one cell of a fine grid count as the
//! same, and the first that the search comes by stands for its cell.

use super::search::Graph;
use super::space::Space;
use crate::robot::configuration::{Configuration, MOVE_AHEAD_M};
use crate::robot::dimensions::ARM_BASE_AHEAD_M;
use crate::robot::dimensions::REACH_M;
use proto::action::Action;
use rapier3d::math::Vec3;

/// Side of a cell, metres.
const CELL_M: f32 = 0.05;
/// Room about the room: keeps cell numbers positive, metres.
const ORIGIN_M: f32 = -50.0;

/// The floor as a graph of poses.
pub struct Floor<'a> {
    /// What is in the way.
    pub space: &'a Space<'a>,
    /// Where the arm is to reach.
    pub place: Vec3,
    /// How near to the place the wrist must come, metres on the floor plane.
    pub slack_m: f32,
    /// What has been tried and failed.
    pub forbidden: &'a [(Configuration, Action)],
}

impl Floor<'_> {
    /// Distance from the body's axis to the place on the floor plane, metres.
    pub fn distance_m(&self, at: &Configuration) -> f32 {
        let (x, z) = (self.place.x - at.x_m, self.place.z - at.z_m);
        libm::sqrtf(x * x + z * z)
    }

    /// Whether the place lies before the robot and within reach: the arm itself may still find things in its way.
    pub fn faces_place(&self, at: &Configuration) -> bool {
        let (sin, cos) = libm::sincosf(at.yaw_rad());
        let (x, z) = (self.place.x - at.x_m, self.place.z - at.z_m);
        let (aside, ahead) = (x * cos - z * sin, x * sin + z * cos - ARM_BASE_AHEAD_M);
        ahead > -self.slack_m && libm::sqrtf(aside * aside + ahead * ahead) <= REACH_M + self.slack_m
    }
}

impl Graph for Floor<'_> {
    type State = Configuration;

    fn key(&self, state: &Configuration) -> u64 {
        let cell = |at_m: f32| ((at_m - ORIGIN_M) / CELL_M) as u64;
        cell(state.x_m) << 32 | cell(state.z_m) << 8 | state.yaw_ticks as u64
    }

    fn successors(&self, state: &Configuration, out: &mut Vec<(Action, Configuration)>) {
        const DRIVING: [Action; 3] =
            [Action::MoveAheadContinuous, Action::RotateRightContinuous, Action::RotateLeftContinuous];
        out.extend(DRIVING.iter().filter_map(|&action| state.after(action).map(|next| (action, next))));
    }

    fn passable(&self, from: &Configuration, action: Action, to: &Configuration) -> bool {
        !self.forbidden.contains(&(*from, action)) && self.space.passable(from, action, to)
    }

    fn bound(&self, state: &Configuration) -> u32 {
        let left_m = self.distance_m(state) - (ARM_BASE_AHEAD_M + REACH_M + self.slack_m);
        // A hair less than whole, for rounding in positions that add up.
        libm::ceilf((left_m / MOVE_AHEAD_M).max(0.0) - 1e-3) as u32
    }
}
