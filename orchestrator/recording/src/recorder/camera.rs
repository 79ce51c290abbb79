//! The head camera as Foxglove sees it: intrinsics, and the chain of frames from the kitchen's floor to the lens.
//!
//! The simulator's world follows AI2-THOR: x right, y up, z ahead, which is left-handed. Foxglove, like ROS, is
//! right-handed with z up. The one mapping between them is [`ros_from_world`]: ahead becomes x, left y, up z.

use crate::schema::foxglove::{CameraCalibration, FrameTransform, Quaternion, Vector3};
use prost_types::Timestamp;
use proto::camera::{FIELD_OF_VIEW_DEG, FRAME_SIDE, HEIGHT_M};

#[derive(Debug, Clone)]
pub struct FrameNames {
    prefix: String,
    /// Optical frame of the head camera: x right, y down, z into the picture.
    pub camera: String,
}

impl FrameNames {
    pub fn under(prefix: &str) -> Self {
        Self { prefix: prefix.to_owned(), camera: format!("{prefix}/camera") }
    }

    /// Of the robot's axis on the floor, x ahead (`robot`), or of something whose place the task says.
    fn of(&self, what: &str) -> String {
        format!("{}/{what}", self.prefix)
    }
}

/// Intrinsics of the head camera. Pixel (0, 0) has its centre at 0, as in ROS, so the axis meets (111.5, 111.5).
pub fn calibration(timestamp: Timestamp, frame_id: &str) -> CameraCalibration {
    let side = FRAME_SIDE as f64;
    let focal_px = side / 2.0 / (FIELD_OF_VIEW_DEG / 2.0).to_radians().tan();
    let centre_px = (side - 1.0) / 2.0;
    CameraCalibration {
        timestamp: Some(timestamp),
        frame_id: frame_id.to_owned(),
        width: FRAME_SIDE as u32,
        height: FRAME_SIDE as u32,
        distortion_model: "plumb_bob".to_owned(),
        d: vec![0.0; 5],
        k: vec![focal_px, 0.0, centre_px, 0.0, focal_px, centre_px, 0.0, 0.0, 1.0],
        r: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: vec![focal_px, 0.0, centre_px, 0.0, 0.0, focal_px, centre_px, 0.0, 0.0, 0.0, 1.0, 0.0],
    }
}

#[derive(Debug, Clone, Default)]
pub struct Places {
    /// x, z.
    pub base_position_m: [f32; 2],
    /// Positive to the right.
    pub base_yaw_rad: f32,
    /// Positive downwards.
    pub camera_pitch_rad: f32,
    /// Others by their frames' names, e.g. `wrist`.
    pub others_m: Vec<(String, [f32; 3])>,
}

pub fn transforms(timestamp: Timestamp, names: &FrameNames, places: &Places) -> Vec<FrameTransform> {
    let [x_m, z_m] = places.base_position_m;
    let at = |parent: &str, child: &str, translation: Vector3, rotation: Quaternion| FrameTransform {
        timestamp: Some(timestamp),
        parent_frame_id: names.of(parent),
        child_frame_id: names.of(child),
        translation: Some(translation),
        rotation: Some(rotation),
    };
    let robot = at(
        "world",
        "robot",
        ros_from_world([x_m, 0.0, z_m]),
        // The simulator's yaw is positive to the right; a positive turn about z up is to the left.
        about_z(-f64::from(places.base_yaw_rad)),
    );
    let camera = at(
        "robot",
        "camera",
        Vector3 { x: 0.0, y: 0.0, z: HEIGHT_M },
        // Downwards is a positive turn about the axis to the left.
        product(&about_y(f64::from(places.camera_pitch_rad)), &BODY_FROM_OPTICAL),
    );
    let others = places.others_m.iter().map(|(name, place_m)| at("world", name, ros_from_world(*place_m), IDENTITY));
    [robot, camera].into_iter().chain(others).collect()
}

fn ros_from_world([x, y, z]: [f32; 3]) -> Vector3 {
    Vector3 { x: f64::from(z), y: -f64::from(x), z: f64::from(y) }
}

const IDENTITY: Quaternion = Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 };

/// From optical axes (right, down, into the picture) to body axes (ahead, left, up).
const BODY_FROM_OPTICAL: Quaternion = Quaternion { x: -0.5, y: 0.5, z: -0.5, w: 0.5 };

fn about_y(angle_rad: f64) -> Quaternion {
    Quaternion { x: 0.0, y: (angle_rad / 2.0).sin(), z: 0.0, w: (angle_rad / 2.0).cos() }
}

fn about_z(angle_rad: f64) -> Quaternion {
    Quaternion { x: 0.0, y: 0.0, z: (angle_rad / 2.0).sin(), w: (angle_rad / 2.0).cos() }
}

/// First `b`, then `a`.
fn product(a: &Quaternion, b: &Quaternion) -> Quaternion {
    Quaternion {
        w: a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z,
        x: a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
        y: a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
        z: a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_6;

    fn rotate(q: &Quaternion, v: [f64; 3]) -> [f64; 3] {
        let inverse = Quaternion { x: -q.x, y: -q.y, z: -q.z, w: q.w };
        let r = product(&product(q, &Quaternion { x: v[0], y: v[1], z: v[2], w: 0.0 }), &inverse);
        [r.x, r.y, r.z]
    }

    fn assert_close(a: [f64; 3], b: [f64; 3]) {
        assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6), "{a:?} {b:?}");
    }

    #[test]
    fn what_lies_right_and_ahead_in_the_simulator_does_so_in_foxglove() {
        // At world (x 1, z 2), turned 90° to the right: looks along world +x, which is -y in right-handed axes.
        let places = Places {
            base_position_m: [1.0, 2.0],
            base_yaw_rad: std::f32::consts::FRAC_PI_2,
            camera_pitch_rad: FRAC_PI_6 as f32,
            ..Places::default()
        };
        let all = transforms(Timestamp::default(), &FrameNames::under("k"), &places);
        let (robot, camera) = (&all[0], &all[1]);
        let robot_rotation = robot.rotation.as_ref().unwrap();
        let translation = robot.translation.as_ref().unwrap();
        assert_close([translation.x, translation.y, translation.z], [2.0, -1.0, 0.0]);
        assert_close(rotate(robot_rotation, [1.0, 0.0, 0.0]), [0.0, -1.0, 0.0]);
        // The axis into the picture points ahead and 30° down; the picture's right is the robot's right.
        let camera_rotation = camera.rotation.as_ref().unwrap();
        assert_close(rotate(camera_rotation, [0.0, 0.0, 1.0]), [FRAC_PI_6.cos(), 0.0, -FRAC_PI_6.sin()]);
        assert_close(rotate(camera_rotation, [1.0, 0.0, 0.0]), [0.0, -1.0, 0.0]);
        assert_eq!((camera.parent_frame_id.as_str(), camera.child_frame_id.as_str()), ("k/robot", "k/camera"));
    }

    #[test]
    fn the_edge_of_the_picture_is_fifty_degrees_off_the_axis() {
        let k = calibration(Timestamp::default(), "c").k;
        let left_edge_px = -0.5;
        let angle = ((left_edge_px - k[2]) / k[0]).atan().to_degrees();
        assert!((angle + 50.0).abs() < 1e-9, "{angle}");
    }
}
