//! Where things can stand on a surface: the level tops of its parts.

use crate::kitchen::room::{Fixture, Surface};
use crate::physics::geometry::Solid;
use crate::shape::{Part, Primitive, Shape};
use rapier3d::math::{Pose3, Vec3};

/// Tops smaller than this along an axis carry nothing, metres: legs, rails.
const NARROW_M: f32 = 0.15;
/// An axis is upright or level if it is this near to it.
const LEVEL: f32 = 1e-3;
/// Room above a surface where nothing hangs, metres.
const OPEN_M: f32 = 3.0;
/// A thing lower than this does not fit below what hangs above, metres.
const LOW_M: f32 = 0.05;

/// Level rectangles along the world's axes on top of a body's parts: boxes whole, upright cylinders by the square in
/// their top. Parts that carry other parts are left out by what lies on them ([`limit`]).
pub fn of(shape: &Shape, world_from_body: &Pose3) -> Vec<Surface> {
    let mut tops = Vec::new();
    for part in &shape.convex_parts() {
        let Some(half) = level_half(part, world_from_body) else { continue };
        if 2.0 * half.x.min(half.z) >= NARROW_M {
            let centre = (*world_from_body * part.body_from_part).translation;
            let (low, high) = (centre - half, centre + half);
            tops.push(Surface { low: low.with_y(high.y), high });
        }
    }
    tops
}

/// Half of the size of a part whose top is level, along the world's axes.
fn level_half(part: &Part, world_from_body: &Pose3) -> Option<Vec3> {
    let rotation = (*world_from_body * part.body_from_part).rotation;
    match part.primitive {
        Primitive::Cuboid { half_extents_m } => {
            let axes = Vec3::AXES.map(|axis| (rotation * axis).abs());
            // Each axis of the box must lie along an axis of the world.
            let along = axes.iter().all(|axis| axis.max_element() >= 1.0 - LEVEL);
            along.then(|| axes[0] * half_extents_m.x + axes[1] * half_extents_m.y + axes[2] * half_extents_m.z)
        }
        Primitive::Cylinder { radius_m, half_height_m } => {
            let side = radius_m * std::f32::consts::FRAC_1_SQRT_2;
            ((rotation * Vec3::Y).y.abs() >= 1.0 - LEVEL).then(|| Vec3::new(side, half_height_m, side))
        }
        Primitive::Capsule { .. } | Primitive::Sphere { .. } | Primitive::Hull { .. } | Primitive::Concave(_) => None,
    }
}

#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum NoTop {
    #[error("its widest level top is {:.2} m wide, and {NARROW_M} m is the least", .width_m)]
    Narrow { width_m: f32 },
    #[error(
        "it is turned: a top must lie level, and a box's sides along the scene's axes (turned by right angles only)"
    )]
    Turned,
    #[error("none of its meshes is a box or a cylinder: model what things stand on as a box or an upright cylinder")]
    NoBox,
}

pub(crate) fn why_none(shape: &Shape, world_from_body: &Pose3) -> NoTop {
    let level = || shape.convex_parts().into_iter().filter_map(|part| level_half(&part, world_from_body));
    let flat = |primitive: &Primitive| matches!(primitive, Primitive::Cuboid { .. } | Primitive::Cylinder { .. });
    if level().next().is_some() {
        NoTop::Narrow { width_m: level().map(|half| 2.0 * half.x.min(half.z)).fold(0.0, f32::max) }
    } else if shape.convex_parts().iter().any(|part| flat(&part.primitive)) {
        NoTop::Turned
    } else {
        NoTop::NoBox
    }
}

/// Sets the height below which things must stay: that of the lowest fixed part above each surface. Surfaces on which
/// something lies all over are taken out.
pub fn limit(surfaces: &mut Vec<Surface>, fixtures: &[Fixture]) {
    let parts: Vec<_> = fixtures
        .iter()
        .flat_map(|fixture| {
            let parts = fixture.shape.convex_parts().into_iter().map(|part| Shape { parts: vec![part] });
            parts.map(|shape| Solid::of(&shape).aabb(&fixture.pose))
        })
        .collect();
    for surface in surfaces.iter_mut() {
        let top = surface.low.y;
        surface.high.y = top + OPEN_M;
        for part in &parts {
            let overlap = part.maxs.min(surface.high) - part.mins.max(surface.low);
            let over = overlap.x > 0.0 && overlap.z > 0.0 && part.maxs.y > top + LEVEL;
            // What merely stands on a part of it is found by the search for free places.
            let covers = overlap.x * overlap.z > 0.5 * surface.area_m2();
            if over && covers {
                surface.high.y = surface.high.y.min(part.mins.y.max(top));
            }
        }
    }
    surfaces.retain(|surface| surface.high.y - surface.low.y > LOW_M);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::physics::geometry::rotation_y;

    fn block(x: f32, y: f32, z: f32) -> Primitive {
        Primitive::Cuboid { half_extents_m: Vec3::new(x, y, z) }
    }

    #[test]
    fn a_table_s_top_is_its_surface_turned_by_a_right_angle() {
        let table = Shape::of(block(0.6, 0.02, 0.4)).with(block(0.03, 0.35, 0.03), 0.5, -0.37, 0.3);
        let pose = Pose3::from_parts(Vec3::new(1.0, 0.73, 2.0), rotation_y(std::f32::consts::FRAC_PI_2));
        let tops = of(&table, &pose);
        assert_eq!(tops.len(), 1, "{tops:?}");
        assert!((tops[0].low - Vec3::new(0.6, 0.75, 1.4)).length() < 1e-5, "{tops:?}");
        assert!((tops[0].high - Vec3::new(1.4, 0.75, 2.6)).length() < 1e-5, "{tops:?}");
        assert!(of(&table, &Pose3::from_parts(Vec3::ZERO, rotation_y(0.3))).is_empty(), "turned by half a right angle");
    }

    #[test]
    fn a_shelf_ends_below_the_next_one() {
        let boards = Shape::of(block(0.4, 0.01, 0.2)).with(block(0.4, 0.01, 0.2), 0.0, 0.4, 0.0);
        let fixture = Fixture { category: "Shelf".into(), shape: boards.clone(), pose: Pose3::identity() };
        let mut tops = of(&boards, &Pose3::identity());
        limit(&mut tops, &[fixture]);
        assert!((tops[0].high.y - 0.39).abs() < 1e-5 && tops[1].high.y > 2.0, "{tops:?}");
    }
}
