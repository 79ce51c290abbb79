//! The robot's configuration in whole ticks, and the effect of each action on it.
//!
//! Everything but the floor position counts in the actions' own steps, so an action undone is undone exactly.

use super::arm::{self, Joints, Unreachable};
use crate::robot::action::Action;
use rapier3d::math::Vec3;
use std::f32::consts::PI;

/// Distance of one `MoveAhead`, metres (reference).
pub const MOVE_AHEAD_M: f32 = 0.2;
/// Angle of one turn of the body, radians (reference).
pub(crate) const TURN_RAD: f32 = PI / 4.0;
/// Wrist travel of one arm motion, metres (reference).
pub const WRIST_STEP_M: f32 = 0.05;
/// Turn of wrist or elbow, radians (reference).
const JOINT_STEP_RAD: f32 = PI / 12.0;
/// Pitch of one look, radians (AI2-THOR).
const LOOK_STEP_RAD: f32 = PI / 6.0;
/// Lowest height of the arm's base, metres (ManipulaTHOR).
pub const ARM_HEIGHT_MIN_M: f32 = 0.4510;
/// Highest height of the arm's base, metres (ManipulaTHOR).
pub const ARM_HEIGHT_MAX_M: f32 = 1.8010;
/// Ticks of the arm's height range: 0.05 of it each.
pub const ARM_HEIGHT_TICKS: i32 = 20;
/// Arm height at an episode's start: 0.8 of the range (reference).
const ARM_HEIGHT_START_TICKS: i32 = 16;
/// Wrist position at an episode's start, in wrist steps: (0, 0, 0.35) m (reference).
const WRIST_START_TICKS: [i32; 3] = [0, 0, 7];
/// Furthest the camera looks up, in look steps (AI2-THOR: 30 degrees).
const LOOK_UP_LIMIT: i32 = -1;
/// Furthest the camera looks down, in look steps (AI2-THOR: 60 degrees).
const LOOK_DOWN_LIMIT: i32 = 2;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Configuration {
    /// Position of the body's axis on the floor, world x, metres.
    pub x_m: f32,
    /// Position of the body's axis on the floor, world z, metres.
    pub z_m: f32,
    /// Yaw in turns of 45 degrees, 0..8.
    pub yaw_ticks: i32,
    /// Camera pitch in looks of 30 degrees, positive down.
    pub look_ticks: i32,
    /// Arm height, 0..=20.
    pub height_ticks: i32,
    /// Wrist position relative to the arm's base, in steps of 0.05 m.
    pub wrist_ticks: [i32; 3],
    /// Elbow about the shoulder-wrist line, in steps of 15 degrees.
    pub elbow_ticks: i32,
    /// Wrist yaw, in steps of 15 degrees.
    pub wrist_yaw_ticks: i32,
    /// Wrist pitch, in steps of 15 degrees.
    pub wrist_pitch_ticks: i32,
}

/// A configuration in continuous terms: what is passed through on the way from one to the next.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Posture {
    pub x_m: f32,
    pub z_m: f32,
    pub yaw_rad: f32,
    /// Height of the arm's base above the floor, metres.
    pub arm_height_m: f32,
    /// Wrist relative to the arm's base, robot's axes, metres.
    pub wrist_m: Vec3,
    /// Elbow about the shoulder-wrist line, radians.
    pub elbow_rad: f32,
    pub wrist_yaw_rad: f32,
    pub wrist_pitch_rad: f32,
}

impl Configuration {
    pub fn start(x_m: f32, z_m: f32, yaw_ticks: i32) -> Self {
        Self {
            x_m,
            z_m,
            yaw_ticks: yaw_ticks.rem_euclid(8),
            look_ticks: 0,
            height_ticks: ARM_HEIGHT_START_TICKS,
            wrist_ticks: WRIST_START_TICKS,
            elbow_ticks: 0,
            wrist_yaw_ticks: 0,
            wrist_pitch_ticks: 0,
        }
    }

    /// Yaw, radians, in (-pi, pi].
    pub fn yaw_rad(&self) -> f32 {
        let ticks = if self.yaw_ticks > 4 { self.yaw_ticks - 8 } else { self.yaw_ticks };
        ticks as f32 * TURN_RAD
    }

    /// Camera pitch, radians, positive down.
    pub fn camera_pitch_rad(&self) -> f32 {
        self.look_ticks as f32 * LOOK_STEP_RAD
    }

    /// The configuration in continuous terms.
    pub fn posture(&self) -> Posture {
        let height = self.height_ticks as f32 / ARM_HEIGHT_TICKS as f32;
        let [x, y, z] = self.wrist_ticks.map(|ticks| ticks as f32 * WRIST_STEP_M);
        Posture {
            x_m: self.x_m,
            z_m: self.z_m,
            yaw_rad: self.yaw_rad(),
            arm_height_m: ARM_HEIGHT_MIN_M + height * (ARM_HEIGHT_MAX_M - ARM_HEIGHT_MIN_M),
            wrist_m: Vec3::new(x, y, z),
            elbow_rad: self.elbow_ticks as f32 * JOINT_STEP_RAD,
            wrist_yaw_rad: self.wrist_yaw_ticks as f32 * JOINT_STEP_RAD,
            wrist_pitch_rad: self.wrist_pitch_ticks as f32 * JOINT_STEP_RAD,
        }
    }

    /// Where an action leads if nothing is in the way; none if it exceeds a range. `PickUp` and Done stay.
    pub fn after(&self, action: Action) -> Option<Self> {
        let mut next = *self;
        match action {
            Action::MoveArmHeightP => next.height_ticks += 1,
            Action::MoveArmHeightM => next.height_ticks -= 1,
            Action::MoveArmXP => next.wrist_ticks[0] += 1,
            Action::MoveArmXM => next.wrist_ticks[0] -= 1,
            Action::MoveArmYP => next.wrist_ticks[1] += 1,
            Action::MoveArmYM => next.wrist_ticks[1] -= 1,
            Action::MoveArmZP => next.wrist_ticks[2] += 1,
            Action::MoveArmZM => next.wrist_ticks[2] -= 1,
            Action::RotateArmWristPitchP => next.wrist_pitch_ticks += 1,
            Action::RotateArmWristPitchM => next.wrist_pitch_ticks -= 1,
            Action::RotateArmWristYawP => next.wrist_yaw_ticks += 1,
            Action::RotateArmWristYawM => next.wrist_yaw_ticks -= 1,
            Action::RotateArmElbowP => next.elbow_ticks += 1,
            Action::RotateArmElbowM => next.elbow_ticks -= 1,
            Action::LookUp => next.look_ticks -= 1,
            Action::LookDown => next.look_ticks += 1,
            Action::MoveAheadContinuous => {
                let (sin, cos) = libm::sincosf(self.yaw_rad());
                next.x_m += MOVE_AHEAD_M * sin;
                next.z_m += MOVE_AHEAD_M * cos;
            }
            Action::RotateRightContinuous => next.yaw_ticks = (self.yaw_ticks + 1).rem_euclid(8),
            Action::RotateLeftContinuous => next.yaw_ticks = (self.yaw_ticks - 1).rem_euclid(8),
            Action::PickUpMidLevel | Action::DoneMidLevel => {}
        }
        let in_range = (0..=ARM_HEIGHT_TICKS).contains(&next.height_ticks)
            && (LOOK_UP_LIMIT..=LOOK_DOWN_LIMIT).contains(&next.look_ticks);
        in_range.then_some(next)
    }
}

impl Posture {
    /// The posture at share `t` in 0..=1 of the way to another; yaw takes the short way round.
    #[must_use]
    pub fn towards(&self, to: &Self, t: f32) -> Self {
        let mix = |a: f32, b: f32| a + (b - a) * t;
        let mut turn = to.yaw_rad - self.yaw_rad;
        if turn > PI {
            turn -= 2.0 * PI;
        } else if turn < -PI {
            turn += 2.0 * PI;
        }
        Self {
            x_m: mix(self.x_m, to.x_m),
            z_m: mix(self.z_m, to.z_m),
            yaw_rad: self.yaw_rad + turn * t,
            arm_height_m: mix(self.arm_height_m, to.arm_height_m),
            wrist_m: self.wrist_m + (to.wrist_m - self.wrist_m) * t,
            elbow_rad: mix(self.elbow_rad, to.elbow_rad),
            wrist_yaw_rad: mix(self.wrist_yaw_rad, to.wrist_yaw_rad),
            wrist_pitch_rad: mix(self.wrist_pitch_rad, to.wrist_pitch_rad),
        }
    }

    /// Whether the arm has the same form as in another posture, wherever the robot stands and the arm rides.
    pub fn same_arm(&self, other: &Self) -> bool {
        self.wrist_m == other.wrist_m
            && self.elbow_rad == other.elbow_rad
            && self.wrist_yaw_rad == other.wrist_yaw_rad
            && self.wrist_pitch_rad == other.wrist_pitch_rad
    }

    pub fn joints(&self) -> Result<Joints, Unreachable> {
        arm::inverse(self.wrist_m, self.elbow_rad, self.wrist_yaw_rad, self.wrist_pitch_rad)
    }
}
