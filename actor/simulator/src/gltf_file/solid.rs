//! Which solid a mesh is: a convex one, or convex pieces of it.

use super::convex;
use super::decompose::{closed, concave};
use super::no_solid::NoSolid;
use super::piece::Piece;
use crate::shape::{Part, Primitive};
use rapier3d::math::Pose3;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Convex {
    /// Take its convex hull.
    Hull,
    /// Cut it into convex pieces for physics; the camera sees the mesh.
    Decompose,
}

/// The solid that a mesh is; `dented` says what to do with one that is not convex.
pub fn part_of(piece: &Piece, dented: Option<Convex>) -> Result<Part, NoSolid> {
    match (convex::part_of(piece), dented) {
        (Err(NoSolid::Dented { .. }), Some(Convex::Hull)) => convex::hull_of(piece),
        (Err(NoSolid::Dented { .. }), Some(Convex::Decompose)) => {
            let primitive = Primitive::Concave(Arc::new(concave(closed(piece)?)?));
            Ok(Part { primitive, body_from_part: Pose3::identity() })
        }
        (found, _) => found,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::triangles_of;
    use crate::physics::geometry::{Solid, rotation_x, rotation_z};
    use crate::shape::Shape;
    use rapier3d::math::{Rot3, Vec3};
    use std::f32::consts::FRAC_PI_2;

    fn piece(shape: &Shape) -> Piece {
        let triangles = triangles_of(shape);
        let vertices: Vec<Vec3> = triangles.iter().flatten().map(|&corner| Vec3::from(corner)).collect();
        let triangles = (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        Piece { vertices, triangles, extras: None }
    }

    #[test]
    fn boxes_and_cylinders_are_recognised_along_each_axis() {
        let half = Vec3::new(0.2, 0.3, 0.1);
        let found = part_of(&piece(&Shape::of(Primitive::Cuboid { half_extents_m: half })), None).unwrap();
        assert_eq!(found.primitive, Primitive::Cuboid { half_extents_m: half });
        for rotation in [Rot3::IDENTITY, rotation_x(FRAC_PI_2), rotation_z(FRAC_PI_2)] {
            let primitive = Primitive::Cylinder { radius_m: 0.1, half_height_m: 0.04 };
            let body_from_part = Pose3::from_parts(Vec3::new(1.0, 2.0, 3.0), rotation);
            let shape = Shape { parts: vec![Part { primitive, body_from_part }] };
            let found = part_of(&piece(&shape), None).unwrap();
            let Primitive::Cylinder { radius_m, half_height_m } = found.primitive else { panic!("{found:?}") };
            assert!((radius_m - 0.1).abs() < 1e-5 && (half_height_m - 0.04).abs() < 1e-5, "{found:?}");
            let (own, given) = (Solid::of(&Shape { parts: vec![found] }), Solid::of(&shape));
            let (own, given) = (own.aabb(&Pose3::identity()), given.aabb(&Pose3::identity()));
            assert!((own.mins - given.mins).length() < 1e-5 && (own.maxs - given.maxs).length() < 1e-5);
        }
    }

    #[test]
    fn a_seam_that_is_written_twice_does_not_hide_a_cylinder() {
        let mut foot = piece(&Shape::of(Primitive::Cylinder { radius_m: 0.02, half_height_m: 0.002 }));
        let seam: Vec<Vec3> = foot.vertices.iter().filter(|v| v.x > 0.0199).map(|v| *v + Vec3::Z * 1e-9).collect();
        assert!(!seam.is_empty());
        foot.vertices.extend(seam);
        assert!(matches!(part_of(&foot, None).unwrap().primitive, Primitive::Cylinder { .. }));
    }

    #[test]
    fn a_round_solid_is_what_it_says_only_if_the_mesh_agrees() {
        let mut ball = piece(&Shape::of(Primitive::Sphere { radius_m: 0.05 }));
        let say = |radius_m: f32| {
            Some(format!(
                r#"{{"solid": "sphere", "radius_m": {radius_m}, "translation": [0, 0, 0], "rotation": [0, 0, 0, 1]}}"#
            ))
        };
        ball.extras = say(0.05);
        assert_eq!(part_of(&ball, None).unwrap().primitive, Primitive::Sphere { radius_m: 0.05 });
        for other in [say(0.06), Some("[1, 2]".into()), None] {
            ball.extras = other;
            // A mesh like any other then, of far more corners than a hull may have.
            assert!(
                matches!(part_of(&ball, Some(Convex::Hull)), Err(NoSolid::TooDetailed { .. })),
                "{:?}",
                ball.extras
            );
        }
    }

    #[test]
    fn what_is_flat_has_no_hull() {
        let flat = Piece { vertices: vec![Vec3::ZERO, Vec3::X, Vec3::Z], triangles: vec![[0, 1, 2]], extras: None };
        assert_eq!(part_of(&flat, Some(Convex::Hull)), Err(NoSolid::Flat));
    }
}
