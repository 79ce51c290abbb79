//! The robot's collision bodies and where a posture puts them.

use super::arm::{self, LINK_LENGTH_M, Unreachable};
use super::configuration::Posture;
use crate::physics::geometry::{rotation_x, rotation_y};
use crate::shape::{Primitive, Shape};
use rapier3d::math::{Pose3, Rot3, Vec3};
use std::f32::consts::FRAC_PI_2;

/// Radius of the body, metres (AI2-THOR's default agent).
pub const BODY_RADIUS_M: f32 = 0.2;
/// Height of the body, metres (AI2-THOR's default agent).
pub const BODY_HEIGHT_M: f32 = 1.8;
/// Height of the head camera on the body's axis, metres (ManipulaTHOR).
pub const CAMERA_HEIGHT_M: f32 = 1.58;
/// The arm's base rides on the front of the body, this far ahead of its axis, metres.
pub const ARM_BASE_AHEAD_M: f32 = BODY_RADIUS_M;
/// Radius of the magnet sphere about the wrist, metres (AI2-THOR's default): what it touches can be picked up.
pub const MAGNET_RADIUS_M: f32 = 0.06;
/// Radius of the hand's solid core, metres. Smaller than the magnet, so that touching need not push.
pub const HAND_RADIUS_M: f32 = 0.035;
const SHOULDER_RADIUS_M: f32 = 0.045;
const UPPER_ARM_RADIUS_M: f32 = 0.032;
const FOREARM_RADIUS_M: f32 = 0.027;

/// Collision bodies: the body itself, then the arm's links in the order of [`LINK_NAMES`].
pub const PART_COUNT: usize = 5;
/// The arm's links, which the camera sees. The body is not among them: the camera sits inside it.
pub const LINK_NAMES: [&str; PART_COUNT - 1] = ["Shoulder", "UpperArm", "Forearm", "Hand"];
/// Index of the hand among the collision bodies.
pub const HAND: usize = 4;

/// Poses of all collision bodies: body, shoulder, upper arm, forearm, hand.
pub type PartPoses = [Pose3; PART_COUNT];

/// Shapes of all collision bodies.
pub fn part_shapes() -> [Shape; PART_COUNT] {
    let link = |radius_m| Shape::of(Primitive::Capsule { radius_m, half_height_m: 0.5 * LINK_LENGTH_M });
    [
        Shape::of(Primitive::Capsule { radius_m: BODY_RADIUS_M, half_height_m: 0.5 * BODY_HEIGHT_M - BODY_RADIUS_M }),
        Shape::of(Primitive::Sphere { radius_m: SHOULDER_RADIUS_M }),
        link(UPPER_ARM_RADIUS_M),
        link(FOREARM_RADIUS_M),
        Shape::of(Primitive::Sphere { radius_m: HAND_RADIUS_M }),
    ]
}

/// Where a posture puts the collision bodies; an error if the arm cannot take it.
pub fn part_poses(posture: &Posture) -> Result<PartPoses, Unreachable> {
    let frames = arm::forward(&posture.joints()?);
    let world_from_robot = world_from_robot(posture);
    let world_from_base = world_from_robot * Pose3::translation(0.0, posture.arm_height_m, ARM_BASE_AHEAD_M);
    // A capsule lies along its y axis, a link along its z axis.
    let along = rotation_x(FRAC_PI_2);
    let link = |middle: Vec3, rotation: Rot3| world_from_base * Pose3::from_parts(middle, rotation * along);
    Ok([
        world_from_robot * Pose3::translation(0.0, 0.5 * BODY_HEIGHT_M, 0.0),
        world_from_base,
        link(0.5 * frames.elbow, frames.upper_arm),
        link(0.5 * (frames.elbow + frames.wrist), frames.forearm),
        world_from_base * Pose3::from_parts(frames.wrist, frames.hand),
    ])
}

/// Pose of the robot's frame: on the floor at the body's axis, turned by its yaw.
pub fn world_from_robot(posture: &Posture) -> Pose3 {
    Pose3::from_parts(Vec3::new(posture.x_m, 0.0, posture.z_m), rotation_y(posture.yaw_rad))
}

/// Pose of the head camera: x right, y up, looks along +z.
pub fn world_from_camera(posture: &Posture, pitch_rad: f32) -> Pose3 {
    world_from_robot(posture) * Pose3::from_parts(Vec3::new(0.0, CAMERA_HEIGHT_M, 0.0), rotation_x(pitch_rad))
}
