//! The robot's dimensions: which are published, which are scaled, which are chosen.
//!
//! *Published*: the six-joint Kinova Gen3, distances between joints as in the maker's URDF description
//! (`kortex_description`, arms/gen3/6dof), ranges of joints as in the user guide (the URDF rounds them down by half a
//! degree). The URDF's frames also step sideways along the joints' axes by 5.4, 6.4 and 0.2 mm. These steps are left
//! out, which moves the wrist by about a centimetre at most (`tests/behaviour/reference/gen3_chain.py` says so).
//! Without them shoulder, elbow and wrist lie in one plane, and the inverse is a triangle.
//!
//! *Scaled*: every published length, by [`SCALE`], so that the stretched arm measures `ManipulaTHOR`'s reach.
//!
//! *Chosen*: the links' radii, before scaling, and how the arm is mounted. Its base lies level within the body, its
//! foot on the body's axis, its own axis ahead. The shoulder then stands [`ARM_BASE_AHEAD_M`] ahead of the body's axis,
//! five centimetres clear of the body. Where the body's round top recedes, above 1.6 m, nothing is modelled between the
//! two. What the Gen3 carries beyond joint 5 is left out: the magnet's centre is the wrist.

use std::f32::consts::PI;

/// Radius of the body, metres (AI2-THOR's default agent).
pub(crate) const BODY_RADIUS_M: f32 = 0.2;
/// Height of the body, metres (AI2-THOR's default agent).
pub(crate) const BODY_HEIGHT_M: f32 = 1.8;
/// Height of the head camera on the body's axis, metres.
pub(crate) const CAMERA_HEIGHT_M: f32 = proto::camera::HEIGHT_M as f32;
/// Reach from shoulder to wrist, metres (`ManipulaTHOR`).
pub const REACH_M: f32 = 0.6335;

/// Gen3: foot of the base to joint 1, and on to the shoulder, joint 2, metres.
const GEN3_BASE_M: f32 = 0.15643 + 0.12838;
/// Gen3: shoulder, joint 2, to elbow, joint 3, metres.
const GEN3_UPPER_ARM_M: f32 = 0.41;
/// Gen3: elbow, joint 3, to where the forearm turns in itself, joint 4, metres.
const GEN3_FOREARM_M: f32 = 0.20843;
/// Gen3: joint 4 to the wrist, joint 5, metres.
const GEN3_WRIST_M: f32 = 0.10593;
/// Radius of the links about the Gen3's large joints, metres (chosen: a little wider than its shells, which are no
/// cylinders).
const LARGE_RADIUS_M: f32 = 0.045;
/// Radius of the link at the Gen3's wrist, metres (chosen likewise).
const SMALL_RADIUS_M: f32 = 0.036;

/// This arm's lengths over the Gen3's.
pub const SCALE: f32 = REACH_M / (GEN3_UPPER_ARM_M + GEN3_FOREARM_M + GEN3_WRIST_M);
pub const UPPER_ARM_LENGTH_M: f32 = SCALE * GEN3_UPPER_ARM_M;
/// Elbow to wrist, metres: the rest of the reach.
pub const FOREARM_LENGTH_M: f32 = REACH_M - UPPER_ARM_LENGTH_M;
/// Length of the forearm's thinner end at the wrist, metres.
pub const WRIST_LENGTH_M: f32 = SCALE * GEN3_WRIST_M;
/// The shoulder is this far ahead of the body's axis, metres: the whole length of the arm's base.
pub const ARM_BASE_AHEAD_M: f32 = SCALE * GEN3_BASE_M;
/// Radius of shoulder, upper arm and forearm, metres.
pub(crate) const LINK_RADIUS_M: f32 = SCALE * LARGE_RADIUS_M;
/// Radius of the forearm's thinner end, metres.
pub(crate) const WRIST_RADIUS_M: f32 = SCALE * SMALL_RADIUS_M;
/// Radius of the magnet sphere about the wrist, metres (AI2-THOR's default): what it touches can be picked up.
pub const MAGNET_RADIUS_M: f32 = 0.06;
/// Radius of the hand's solid core, metres (chosen). Smaller than the magnet, so that touching need not push.
pub(crate) const HAND_RADIUS_M: f32 = 0.035;

/// Joint 2, upper arm against the base's axis, either way (Gen3).
pub(crate) const SHOULDER_LIMIT_RAD: f32 = 128.9 * PI / 180.0;
/// Joint 3, the elbow's bend from straight (Gen3).
pub(crate) const ELBOW_LIMIT_RAD: f32 = 147.8 * PI / 180.0;
/// Joint 5, hand against forearm (Gen3). Yaw and pitch of the hand each keep to it; the angle between the two axes,
/// whose cosine is the product of their cosines, then does so too.
pub(crate) const WRIST_LIMIT_RAD: f32 = 120.3 * PI / 180.0;
/// The shoulder-wrist line rises or falls at most this much over its run on the floor plane: the tangent of 80 degrees
/// (chosen). On a steep line "above it" turns about with the least motion of the wrist; upright it means nothing.
pub(crate) const LINE_STEEPNESS_LIMIT: f32 = 5.671_282;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_stretched_arm_measures_the_reach_and_clears_the_body() {
        assert_eq!(UPPER_ARM_LENGTH_M + FOREARM_LENGTH_M, REACH_M);
        assert!((SCALE - 0.874_565).abs() < 1e-6);
        assert!((FOREARM_LENGTH_M - SCALE * (GEN3_FOREARM_M + GEN3_WRIST_M)).abs() < 1e-6);
        let gap_m = ARM_BASE_AHEAD_M - BODY_RADIUS_M - LINK_RADIUS_M;
        assert!((0.005..0.015).contains(&gap_m), "{gap_m} m between body and an upright upper arm");
    }
}
