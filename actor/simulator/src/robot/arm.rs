//! The arm: six joints, closed-form inverse kinematics.
//!
//! Frame: the shoulder's, x right, y up, z ahead of the robot. The base's axis is z; with every joint at 0 the arm is
//! stretched along it. From the shoulder on:
//!
//! | angle | turns | Gen3, six joints |
//! |---|---|---|
//! | base roll | everything about the base's axis | joint 1, continuous |
//! | shoulder | upper arm away from the base's axis | joint 2 |
//! | upper arm roll | elbow and forearm about the upper arm | none: the seven-joint Gen3 has it, continuous |
//! | elbow | forearm against upper arm | joint 3 |
//! | wrist yaw, wrist pitch | hand against forearm | joints 4, 5 and 6 together |
//!
//! The upper arm's roll is what the task's elbow actions need: a six-joint Gen3 with its wrist in place cannot move its
//! elbow. The Gen3's last three joints turn the hand any way; the task turns it in two.
//!
//! The inverse is one triangle: shoulder, elbow, wrist. Distance and lengths give its shape; it stands on the
//! shoulder-wrist line, turned about that line as told (0 = the elbow above it, positive = to the left).

use super::dimensions::{
    ARM_BASE_AHEAD_M, BODY_RADIUS_M, ELBOW_LIMIT_RAD, FOREARM_LENGTH_M, LINE_STEEPNESS_LIMIT, LINK_RADIUS_M, REACH_M,
    SHOULDER_LIMIT_RAD, UPPER_ARM_LENGTH_M, WRIST_LIMIT_RAD,
};
use crate::physics::geometry::{length, rotation_x, rotation_y, rotation_z};
use rapier3d::math::{Rot3, Vec3};

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Joints {
    /// About the base's axis; 0 = the shoulder lifts the upper arm, positive = it lifts it to the left.
    pub base_roll_rad: f32,
    /// Upper arm away from the base's axis.
    pub shoulder_rad: f32,
    /// Elbow's axis about the upper arm; 0 = the elbow bends back towards the base's axis.
    pub upper_arm_roll_rad: f32,
    /// Bend of the elbow; 0 = straight.
    pub elbow_rad: f32,
    /// Hand against forearm, to the right.
    pub wrist_yaw_rad: f32,
    /// Hand against forearm, downwards.
    pub wrist_pitch_rad: f32,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frames {
    pub elbow: Vec3,
    pub wrist: Vec3,
    /// Rotation of the upper arm: its z axis runs from shoulder to elbow.
    pub upper_arm: Rot3,
    /// Rotation of the forearm: its z axis runs from elbow to wrist.
    pub forearm: Rot3,
    pub hand: Rot3,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("out of the arm's reach, beyond a joint limit, or in the robot's own body")]
pub struct Unreachable;

/// Joint angles that bring the wrist to a position (shoulder's frame, metres) with the elbow turned about the
/// shoulder-wrist line by `elbow_roll_rad` and the hand turned as given.
pub fn inverse(
    wrist: Vec3,
    elbow_roll_rad: f32,
    wrist_yaw_rad: f32,
    wrist_pitch_rad: f32,
) -> Result<Joints, Unreachable> {
    let (a, b) = (UPPER_ARM_LENGTH_M, FOREARM_LENGTH_M);
    let distance = length(wrist);
    if !(distance > a - b && distance <= REACH_M) {
        return Err(Unreachable);
    }
    let horizontal = f32::sqrt(wrist.x * wrist.x + wrist.z * wrist.z);
    // The law of cosines by half angles, tan²(e/2) = ((a+b)² − d²) / (d² − (a−b)²): it keeps its digits where the arm
    // is all but stretched, and acos does not.
    let opposite = (REACH_M - distance) * (REACH_M + distance);
    let adjacent = (distance - (a - b)) * (distance + (a - b));
    let elbow_rad = 2.0 * libm::atan2f(f32::sqrt(opposite), f32::sqrt(adjacent));
    if wrist.y.abs() > LINE_STEEPNESS_LIMIT * horizontal || elbow_rad > ELBOW_LIMIT_RAD {
        return Err(Unreachable);
    }
    // The triangle's corner at the shoulder; its height is twice its area over the line.
    let sin_elbow = 0.5 * f32::sqrt(opposite * adjacent) / (a * b);
    let sin_corner = b * sin_elbow / distance;
    let cos_corner = (distance * distance + (a - b) * (a + b)) / (2.0 * a * distance);

    let along = wrist / distance;
    let right = Vec3::new(wrist.z, 0.0, -wrist.x) / horizontal;
    let above = along.cross(right);
    let (sin_roll, cos_roll) = libm::sincosf(elbow_roll_rad);
    let upper_arm = along * cos_corner + (above * cos_roll - right * sin_roll) * sin_corner;
    if !clear_of_body(upper_arm * a, wrist) {
        return Err(Unreachable);
    }

    // The elbow's axis is square to the triangle. Measured against where the first two joints alone would put it, it
    // gives the upper arm's roll; so the two rolls agree even where the arm lies along the base's axis, and each of
    // them alone could be anything.
    let elbow_axis = right * cos_roll + above * sin_roll;
    let lift = f32::sqrt(upper_arm.x * upper_arm.x + upper_arm.y * upper_arm.y);
    let (sin_base, cos_base) = if lift > 0.0 { (-upper_arm.x / lift, upper_arm.y / lift) } else { (0.0, 1.0) };
    let unrolled_x = Vec3::new(cos_base, sin_base, 0.0);
    let unrolled_y = upper_arm.cross(unrolled_x);
    let joints = Joints {
        base_roll_rad: libm::atan2f(sin_base, cos_base),
        shoulder_rad: libm::atan2f(lift, upper_arm.z),
        upper_arm_roll_rad: libm::atan2f(elbow_axis.dot(unrolled_y), elbow_axis.dot(unrolled_x)),
        elbow_rad,
        wrist_yaw_rad,
        wrist_pitch_rad,
    };
    if within_limits(&joints) { Ok(joints) } else { Err(Unreachable) }
}

/// Whether every joint is within its limits. Both rolls are continuous and have none.
pub fn within_limits(joints: &Joints) -> bool {
    joints.shoulder_rad.abs() <= SHOULDER_LIMIT_RAD
        && (0.0..=ELBOW_LIMIT_RAD).contains(&joints.elbow_rad)
        && joints.wrist_yaw_rad.abs() <= WRIST_LIMIT_RAD
        && joints.wrist_pitch_rad.abs() <= WRIST_LIMIT_RAD
}

/// Whether upper arm and forearm keep off the robot's own body, taken as a column without end: so it makes no
/// difference at which height the arm rides, and the arm never reaches over the head.
fn clear_of_body(elbow: Vec3, wrist: Vec3) -> bool {
    const LEAST_M: f32 = BODY_RADIUS_M + LINK_RADIUS_M;
    let square_to_axis = |from: Vec3, to: Vec3| {
        // On the floor plane, from the body's axis: the nearest point of a link.
        let (x, z) = (from.x, from.z + ARM_BASE_AHEAD_M);
        let (way_x, way_z) = (to.x - from.x, to.z - from.z);
        let way_square = way_x * way_x + way_z * way_z;
        let share = if way_square > 0.0 { (-(x * way_x + z * way_z) / way_square).clamp(0.0, 1.0) } else { 0.0 };
        let (x, z) = (x + share * way_x, z + share * way_z);
        x * x + z * z
    };
    square_to_axis(Vec3::ZERO, elbow) >= LEAST_M * LEAST_M && square_to_axis(elbow, wrist) >= LEAST_M * LEAST_M
}

pub fn forward(joints: &Joints) -> Frames {
    let upper_arm =
        rotation_z(joints.base_roll_rad) * rotation_x(-joints.shoulder_rad) * rotation_z(joints.upper_arm_roll_rad);
    let forearm = upper_arm * rotation_x(joints.elbow_rad);
    let elbow = upper_arm * Vec3::new(0.0, 0.0, UPPER_ARM_LENGTH_M);
    let wrist = elbow + forearm * Vec3::new(0.0, 0.0, FOREARM_LENGTH_M);
    let hand = forearm * rotation_y(joints.wrist_yaw_rad) * rotation_x(joints.wrist_pitch_rad);
    Frames { elbow, wrist, upper_arm, forearm, hand }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f32::consts::{FRAC_PI_2, PI};

    /// Elbow position by another way than `inverse`: on the circle about the line, in double precision.
    fn elbow_by_circle(wrist: Vec3, roll_rad: f32) -> [f64; 3] {
        let [x, y, z] = wrist.to_array().map(f64::from);
        let (a, b) = (f64::from(UPPER_ARM_LENGTH_M), f64::from(FOREARM_LENGTH_M));
        let distance = (x * x + y * y + z * z).sqrt();
        let foot = (a * a - b * b + distance * distance) / (2.0 * distance);
        let height = (a * a - foot * foot).max(0.0).sqrt();
        let (yaw, pitch) = (x.atan2(z), y.atan2(x.hypot(z)));
        let (sin_roll, cos_roll) = f64::from(roll_rad).sin_cos();
        // Before it is turned by yaw and pitch the line runs ahead, `up` is above it, `left` to its left.
        let (up, left) = (height * cos_roll, height * sin_roll);
        let ahead = foot * pitch.cos() - up * pitch.sin();
        let height = foot * pitch.sin() + up * pitch.cos();
        [ahead * yaw.sin() - left * yaw.cos(), height, ahead * yaw.cos() + left * yaw.sin()]
    }

    /// Least distance of the arm from the body's axis on the floor plane, by many points.
    fn nearest_to_body(elbow: [f64; 3], wrist: Vec3) -> f64 {
        let wrist = wrist.to_array().map(f64::from);
        let links = [([0.0; 3], elbow), (elbow, wrist)];
        let points = links.iter().flat_map(|(from, to)| {
            (0..=400).map(move |k| {
                let share = f64::from(k) / 400.0;
                let at = |axis: usize| from[axis] + share * (to[axis] - from[axis]);
                at(0).hypot(at(2) + f64::from(ARM_BASE_AHEAD_M))
            })
        });
        points.fold(f64::INFINITY, f64::min)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        #[test]
        fn forward_undoes_inverse_and_refusals_have_a_reason(
            x in -0.65f32..0.65, y in -0.65f32..0.65, z in -0.3f32..0.65,
            roll in -4.0f32..4.0, yaw in -2.2f32..2.2, pitch in -2.2f32..2.2,
        ) {
            let wrist = Vec3::new(x, y, z);
            let elbow = elbow_by_circle(wrist, roll);
            let gap_m = nearest_to_body(elbow, wrist) - f64::from(BODY_RADIUS_M + LINK_RADIUS_M);
            if let Ok(joints) = inverse(wrist, roll, yaw, pitch) {
                let frames = forward(&joints);
                prop_assert!((frames.wrist - wrist).length() < 1e-5, "{frames:?}");
                let away = frames.elbow - Vec3::from_array(elbow.map(|axis| axis as f32));
                // Where the arm is all but stretched, the elbow's height is the root of a rounding.
                prop_assert!(away.length() < 2e-4, "{away}");
                prop_assert!(within_limits(&joints) && gap_m > -1e-4, "{joints:?}, {gap_m} m to the body");
                let turn = frames.forearm.inverse() * frames.hand;
                let wanted = Vec3::new(yaw.sin() * pitch.cos(), -pitch.sin(), yaw.cos() * pitch.cos());
                prop_assert!((turn * Vec3::Z - wanted).length() < 1e-5);
            } else {
                let (a, b) = (UPPER_ARM_LENGTH_M, FOREARM_LENGTH_M);
                let folded = (a * a + b * b + 2.0 * a * b * ELBOW_LIMIT_RAD.cos()).sqrt();
                let far = wrist.length() > REACH_M - 1e-5;
                let near = wrist.length() < folded + 1e-5;
                let steep = y.atan2(x.hypot(z)).abs() > (80.0 * PI / 180.0) - 1e-5;
                let in_body = gap_m < 1e-4;
                let shoulder_bent = elbow[2] / f64::from(a) < f64::from(SHOULDER_LIMIT_RAD.cos()) + 1e-5;
                let hand_bent = yaw.abs().max(pitch.abs()) > WRIST_LIMIT_RAD - 1e-6;
                prop_assert!(far || near || steep || in_body || shoulder_bent || hand_bent, "{wrist:?}, {roll}");
            }
        }

        /// The workspace that is promised: in front of the shoulder, between 0.2 m and the reach, from 80 degrees below
        /// level to 40 above it, with the elbow above and the hand up to 120 degrees aside.
        #[test]
        fn the_workspace_in_front_is_reachable(
            distance in 0.2f32..REACH_M, yaw in -FRAC_PI_2..FRAC_PI_2, pitch in -79.9f32..40.0,
            hand_yaw in -2.09f32..2.09, hand_pitch in -2.09f32..2.09,
        ) {
            let pitch = pitch * PI / 180.0;
            let wrist = distance * Vec3::new(yaw.sin() * pitch.cos(), pitch.sin(), yaw.cos() * pitch.cos());
            prop_assert!(inverse(wrist, 0.0, hand_yaw, hand_pitch).is_ok(), "{wrist:?}");
        }

        /// Along the base's axis each of the two rolls alone is anything; the arm must not notice.
        #[test]
        fn an_upper_arm_along_the_base_axis_is_no_exception(
            elbow_rad in 0.05f32..2.5, roll in -PI..PI, tilt in -5f32..-1.0, towards in -PI..PI,
        ) {
            let tilt = 10f32.powf(tilt);
            let joints = Joints {
                base_roll_rad: towards,
                shoulder_rad: tilt,
                upper_arm_roll_rad: roll,
                elbow_rad,
                wrist_yaw_rad: 0.0,
                wrist_pitch_rad: 0.0,
            };
            let wanted = forward(&joints);
            // The elbow's turn about the line, from positions alone.
            let along = wanted.wrist.normalize();
            let right = Vec3::new(wanted.wrist.z, 0.0, -wanted.wrist.x).normalize();
            let off = wanted.elbow - along * wanted.elbow.dot(along);
            let elbow_roll = (-off.dot(right)).atan2(off.dot(along.cross(right)));
            let found = forward(&inverse(wanted.wrist, elbow_roll, 0.0, 0.0).unwrap());
            prop_assert!((found.wrist - wanted.wrist).length() < 1e-5);
            prop_assert!((found.elbow - wanted.elbow).length() < 1e-4, "{} {}", found.elbow, wanted.elbow);
        }
    }

    #[test]
    fn a_stretched_arm_keeps_its_digits() {
        for share in [1.0 - 1e-6, 1.0 - 1e-5, 1.0 - 1e-4] {
            let wrist = Vec3::new(0.2, -0.3, 0.9).normalize() * (share * REACH_M);
            let frames = forward(&inverse(wrist, 0.7, 0.0, 0.0).unwrap());
            assert!((frames.wrist - wrist).length() < 2e-6, "{share}: {}", frames.wrist - wrist);
        }
    }
}
