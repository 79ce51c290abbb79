//! The arm: six joints, closed-form inverse kinematics.
//!
//! Frame: the arm's base, x right, y up, z ahead of the robot. Two links of equal length join shoulder, elbow and
//! wrist. The shoulder's yaw and pitch aim the shoulder-wrist line, its roll turns the elbow about that line (0 = the
//! elbow above it), the elbow's flexion sets the distance. The wrist's yaw and pitch turn the hand against the forearm.

use crate::physics::geometry::{rotation_x, rotation_y, rotation_z};
use rapier3d::math::{Rot3, Vec3};
use std::f32::consts::{FRAC_PI_2, PI};

/// Reach from shoulder to wrist, metres (ManipulaTHOR).
pub const REACH_M: f32 = 0.6335;
/// Length of the upper arm and of the forearm, metres.
pub const LINK_LENGTH_M: f32 = 0.5 * REACH_M;
/// Shoulder yaw, either way: the wrist stays in front of the arm's base.
pub const SHOULDER_YAW_LIMIT_RAD: f32 = FRAC_PI_2;
/// Shoulder pitch, either way: beyond it yaw loses its meaning.
pub const SHOULDER_PITCH_LIMIT_RAD: f32 = 80.0 * PI / 180.0;
/// Shoulder roll (elbow about the shoulder-wrist line), either way.
pub const SHOULDER_ROLL_LIMIT_RAD: f32 = FRAC_PI_2 + 1e-3;
/// Most the elbow bends from straight.
pub const ELBOW_LIMIT_RAD: f32 = 160.0 * PI / 180.0;
/// Wrist yaw and pitch, either way.
pub const WRIST_LIMIT_RAD: f32 = FRAC_PI_2 + 1e-3;
/// Distance the elbow keeps behind itself from the arm base's plane, metres: further back stands the body.
pub const ELBOW_BACK_LIMIT_M: f32 = 0.0;

/// Joint angles, radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Joints {
    /// Shoulder-wrist line to the right.
    pub shoulder_yaw_rad: f32,
    /// Shoulder-wrist line upwards.
    pub shoulder_pitch_rad: f32,
    /// Elbow about the shoulder-wrist line; 0 = above it.
    pub shoulder_roll_rad: f32,
    /// Bend of the elbow; 0 = straight.
    pub elbow_rad: f32,
    /// Hand against forearm, to the right.
    pub wrist_yaw_rad: f32,
    /// Hand against forearm, downwards.
    pub wrist_pitch_rad: f32,
}

/// Where the arm's parts are, in the frame of its base.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frames {
    /// Elbow position, metres.
    pub elbow: Vec3,
    /// Wrist position, metres.
    pub wrist: Vec3,
    /// Rotation of the upper arm: its z axis runs from shoulder to elbow.
    pub upper_arm: Rot3,
    /// Rotation of the forearm: its z axis runs from elbow to wrist.
    pub forearm: Rot3,
    /// Rotation of the hand.
    pub hand: Rot3,
}

/// The arm cannot take this configuration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("out of the arm's reach or beyond a joint limit")]
pub struct Unreachable;

/// Joint angles that bring the wrist to a position with the given roll of the elbow and turn of the hand.
pub fn inverse(wrist: Vec3, roll_rad: f32, wrist_yaw_rad: f32, wrist_pitch_rad: f32) -> Result<Joints, Unreachable> {
    let distance = wrist.length();
    if !(distance > 0.0 && distance <= REACH_M) {
        return Err(Unreachable);
    }
    let horizontal = libm::sqrtf(wrist.x * wrist.x + wrist.z * wrist.z);
    let joints = Joints {
        shoulder_yaw_rad: libm::atan2f(wrist.x, wrist.z),
        shoulder_pitch_rad: libm::atan2f(wrist.y, horizontal),
        shoulder_roll_rad: roll_rad,
        elbow_rad: 2.0 * libm::acosf((distance / REACH_M).min(1.0)),
        wrist_yaw_rad,
        wrist_pitch_rad,
    };
    if !within_limits(&joints) || forward(&joints).elbow.z < ELBOW_BACK_LIMIT_M {
        return Err(Unreachable);
    }
    Ok(joints)
}

/// Whether every joint is within its limits.
pub fn within_limits(joints: &Joints) -> bool {
    joints.shoulder_yaw_rad.abs() <= SHOULDER_YAW_LIMIT_RAD
        && joints.shoulder_pitch_rad.abs() <= SHOULDER_PITCH_LIMIT_RAD
        && joints.shoulder_roll_rad.abs() <= SHOULDER_ROLL_LIMIT_RAD
        && (0.0..=ELBOW_LIMIT_RAD).contains(&joints.elbow_rad)
        && joints.wrist_yaw_rad.abs() <= WRIST_LIMIT_RAD
        && joints.wrist_pitch_rad.abs() <= WRIST_LIMIT_RAD
}

/// Where the arm's parts are for these joint angles.
pub fn forward(joints: &Joints) -> Frames {
    let line = rotation_y(joints.shoulder_yaw_rad)
        * rotation_x(-joints.shoulder_pitch_rad)
        * rotation_z(joints.shoulder_roll_rad);
    // Both links lean away from the line by half of the elbow's bend.
    let upper_arm = line * rotation_x(-0.5 * joints.elbow_rad);
    let forearm = line * rotation_x(0.5 * joints.elbow_rad);
    let elbow = upper_arm * Vec3::new(0.0, 0.0, LINK_LENGTH_M);
    let wrist = elbow + forearm * Vec3::new(0.0, 0.0, LINK_LENGTH_M);
    let hand = forearm * rotation_y(joints.wrist_yaw_rad) * rotation_x(joints.wrist_pitch_rad);
    Frames { elbow, wrist, upper_arm, forearm, hand }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn forward_undoes_inverse(
            x in -0.7f32..0.7, y in -0.7f32..0.7, z in -0.7f32..0.7,
            roll in -1.5f32..1.5, yaw in -1.5f32..1.5, pitch in -1.5f32..1.5,
        ) {
            let wrist = Vec3::new(x, y, z);
            if let Ok(joints) = inverse(wrist, roll, yaw, pitch) {
                    let frames = forward(&joints);
                    prop_assert!((frames.wrist - wrist).length() < 1e-4, "{frames:?}");
                    prop_assert!((frames.elbow.length() - LINK_LENGTH_M).abs() < 1e-5);
                    prop_assert!(((frames.wrist - frames.elbow).length() - LINK_LENGTH_M).abs() < 1e-5);
                    prop_assert!(within_limits(&joints) && z >= -1e-6 && frames.elbow.z >= 0.0);
                    prop_assert!((frames.hand.length() - 1.0).abs() < 1e-5);
            } else {
                    // Whatever is refused breaks a limit that can be stated without inverse kinematics.
                    let horizontal = x.hypot(z);
                    let far = wrist.length() > REACH_M;
                    let near = wrist.length() < REACH_M * (0.5 * ELBOW_LIMIT_RAD).cos() + 1e-5;
                    let steep = y.atan2(horizontal).abs() > SHOULDER_PITCH_LIMIT_RAD - 1e-5;
                    let behind = z < 1e-5;
                    let bend = (wrist.length() / REACH_M).min(1.0).acos();
                    // Elbow = half of the line plus its height above the line, rolled about it.
                    let along = wrist.normalize();
                    let right = Vec3::new(z, 0.0, -x) / horizontal;
                    let above = along.cross(right);
                    let elbow = 0.5 * wrist + LINK_LENGTH_M * bend.sin() * (above * roll.cos() - right * roll.sin());
                    prop_assert!(far || near || steep || behind || elbow.z < 1e-4, "{wrist:?} {elbow:?}");
            }
        }
    }

    #[test]
    fn the_start_position_is_reachable_with_the_elbow_above() {
        let joints = inverse(Vec3::new(0.0, 0.0, 0.35), 0.0, 0.0, 0.0).unwrap();
        let frames = forward(&joints);
        assert!(frames.elbow.y > 0.2 && frames.elbow.x.abs() < 1e-6);
    }
}
