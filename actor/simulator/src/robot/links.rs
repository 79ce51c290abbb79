//! The robot's collision bodies and where a posture puts them.
//!
//! Every link's body has its origin at the link's far end, which travels furthest: whoever bounds the travel of the
//! origins bounds that of the links.

use super::arm::{self, Unreachable};
use super::configuration::Posture;
use super::dimensions::{
    ARM_BASE_AHEAD_M, BODY_HEIGHT_M, BODY_RADIUS_M, CAMERA_HEIGHT_M, FOREARM_LENGTH_M, HAND_RADIUS_M, LINK_RADIUS_M,
    UPPER_ARM_LENGTH_M, WRIST_LENGTH_M, WRIST_RADIUS_M,
};
use crate::physics::geometry::{rotation_x, rotation_y};
use crate::shape::{Part, Primitive, Shape};
use rapier3d::math::{Pose3, Rot3, Vec3};
use std::f32::consts::FRAC_1_SQRT_2;

/// Collision bodies: the body itself, then the arm's links in the order of [`LINK_NAMES`].
pub const PART_COUNT: usize = 6;
/// The arm's links, which the camera sees. The body is not among them: the camera sits inside it.
pub(crate) const LINK_NAMES: [&str; PART_COUNT - 1] = ["Shoulder", "UpperArm", "Forearm", "Wrist", "Hand"];
/// Index of the hand among the collision bodies.
pub const HAND: usize = 5;

/// Poses of all collision bodies: body, shoulder, upper arm, forearm, wrist, hand.
pub type PartPoses = [Pose3; PART_COUNT];

pub fn part_shapes() -> [Shape; PART_COUNT] {
    [
        Shape::of(Primitive::Capsule { radius_m: BODY_RADIUS_M, half_height_m: 0.5 * BODY_HEIGHT_M - BODY_RADIUS_M }),
        // The end of the base that looks out of the body.
        link(ARM_BASE_AHEAD_M - BODY_RADIUS_M, LINK_RADIUS_M),
        link(UPPER_ARM_LENGTH_M, LINK_RADIUS_M),
        link(FOREARM_LENGTH_M - WRIST_LENGTH_M, LINK_RADIUS_M),
        link(WRIST_LENGTH_M, WRIST_RADIUS_M),
        Shape::of(Primitive::Sphere { radius_m: HAND_RADIUS_M }),
    ]
}

/// A capsule about the z axis from `-length_m` to the origin. The primitive itself lies along y.
fn link(length_m: f32, radius_m: f32) -> Shape {
    let along_z = Rot3::from_xyzw(FRAC_1_SQRT_2, 0.0, 0.0, FRAC_1_SQRT_2);
    Shape {
        parts: vec![Part {
            primitive: Primitive::Capsule { radius_m, half_height_m: 0.5 * length_m },
            body_from_part: Pose3::from_parts(Vec3::new(0.0, 0.0, -0.5 * length_m), along_z),
        }],
    }
}

/// Where a posture puts the collision bodies; an error if the arm cannot take it.
pub fn part_poses(posture: &Posture) -> Result<PartPoses, Unreachable> {
    Ok(on_the_floor(posture, &arm_poses(posture)?))
}

/// The way from one posture to another. Where the arm keeps its form on it, that is worked out once.
#[derive(Debug, Clone, Copy)]
pub struct Motion {
    from: Posture,
    to: Posture,
    rigid: Option<ArmPoses>,
}

impl Motion {
    /// The way between two postures; an error if the arm keeps its form and cannot take it.
    pub fn between(from: &Posture, to: &Posture) -> Result<Self, Unreachable> {
        let rigid = if from.same_arm(to) { Some(arm_poses(from)?) } else { None };
        Ok(Self { from: *from, to: *to, rigid })
    }

    /// Where the collision bodies are at share `t` in 0..=1 of the way, bit for bit what [`part_poses`] says of
    /// [`Posture::towards`].
    pub fn at(&self, t: f32) -> Result<PartPoses, Unreachable> {
        let posture = self.from.towards(&self.to, t);
        match &self.rigid {
            Some(arm) => Ok(on_the_floor(&posture, arm)),
            None => part_poses(&posture),
        }
    }
}

/// Poses of the arm's moving links (upper arm, forearm, wrist, hand) in the shoulder's frame.
type ArmPoses = [Pose3; PART_COUNT - 2];

fn arm_poses(posture: &Posture) -> Result<ArmPoses, Unreachable> {
    let frames = arm::forward(&posture.joints()?);
    let forearm_end = frames.wrist - frames.forearm * Vec3::new(0.0, 0.0, WRIST_LENGTH_M);
    Ok([
        Pose3::from_parts(frames.elbow, frames.upper_arm),
        Pose3::from_parts(forearm_end, frames.forearm),
        Pose3::from_parts(frames.wrist, frames.forearm),
        Pose3::from_parts(frames.wrist, frames.hand),
    ])
}

/// All collision bodies, the arm on the body, the body on the floor.
fn on_the_floor(posture: &Posture, arm: &ArmPoses) -> PartPoses {
    let world_from_robot = world_from_robot(posture);
    let world_from_shoulder = world_from_robot * Pose3::translation(0.0, posture.arm_height_m, ARM_BASE_AHEAD_M);
    let [upper_arm, forearm, wrist, hand] = arm.map(|pose| world_from_shoulder * pose);
    let body = world_from_robot * Pose3::translation(0.0, 0.5 * BODY_HEIGHT_M, 0.0);
    [body, world_from_shoulder, upper_arm, forearm, wrist, hand]
}

/// Pose of the robot's frame: on the floor at the body's axis, turned by its yaw.
pub fn world_from_robot(posture: &Posture) -> Pose3 {
    Pose3::from_parts(Vec3::new(posture.x_m, 0.0, posture.z_m), rotation_y(posture.yaw_rad))
}

/// Pose of the head camera: x right, y up, looks along +z.
pub fn world_from_camera(posture: &Posture, pitch_rad: f32) -> Pose3 {
    world_from_robot(posture) * Pose3::from_parts(Vec3::new(0.0, CAMERA_HEIGHT_M, 0.0), rotation_x(pitch_rad))
}
