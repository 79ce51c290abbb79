//! Between glTF's axes and ours.
//!
//! glTF is right-handed: y up, and a camera at rest looks along −z with x to its right. We are left-handed: x right,
//! y up, z ahead. One axis is flipped, z; what is right or up stays so. A mirror turns rotations about x and y round,
//! and turns every triangle inside out, so that its corners are listed in reverse.

use rapier3d::math::{Pose3, Rot3, Vec3};

/// A point or a direction, either way.
pub fn vector(v: Vec3) -> Vec3 {
    Vec3::new(v.x, v.y, -v.z)
}

pub fn rotation(r: Rot3) -> Rot3 {
    Rot3::from_xyzw(-r.x, -r.y, r.z, r.w)
}

pub fn pose(p: Pose3) -> Pose3 {
    Pose3::from_parts(vector(p.translation), rotation(p.rotation))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn mirroring_commutes_with_moving(
            axis in prop::array::uniform3(-2.0_f32..2.0),
            at in prop::array::uniform3(-5.0_f32..5.0),
            point in prop::array::uniform3(-5.0_f32..5.0),
        ) {
            let moved = Pose3::new(Vec3::from(at), Vec3::from(axis));
            let point = Vec3::from(point);
            let difference = vector(moved * point) - pose(moved) * vector(point);
            prop_assert!(difference.length() < 1e-4, "{difference}");
        }
    }
}
