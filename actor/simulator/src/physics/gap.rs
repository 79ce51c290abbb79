//! How far apart two convex solids are; below zero, how deeply they overlap.
//!
//! Spheres and capsules are a point or a segment with a radius about it. Their distance is that of point or segment,
//! less the radius: exact also where they overlap, as long as point or segment itself stays outside, and much cheaper
//! than a search for the penetration depth. Nearly all of the robot is made of them, and nearly all of a kitchen is
//! made of boxes and upright cylinders: these pairs are done here. parry's search (GJK) does the rest; along curved
//! surfaces it can end millimetres early.

use super::geometry::length;
use rapier3d::geometry::SharedShape;
use rapier3d::math::{Pose3, Vec3};
use rapier3d::parry::query;
use rapier3d::parry::shape::{Segment, Shape};

/// What a convex solid is, once its rounding is taken off.
enum Core<'a> {
    /// A sphere's centre, a capsule's axis: two ends, which a sphere has in one place.
    Segment(Segment),
    Cuboid(Vec3),
    Cylinder {
        half_height_m: f32,
        radius_m: f32,
    },
    Other(&'a dyn Shape),
}

/// Distance between two convex solids, metres. Negative: they overlap, and this is how far one would have to move out
/// of the other; where a capsule's axis or a sphere's centre is in a box or cylinder, it is the radius, and not
/// measured further.
pub fn gap_m(pose: &Pose3, shape: &SharedShape, other_pose: &Pose3, other: &SharedShape) -> f32 {
    let ((core, radius_m), (other_core, other_radius_m)) = (core(shape), core(other));
    if let Core::Segment(segment) = &core
        && let Some(distance_m) = segment_distance_m(&segment_in(segment, &other_pose.inv_mul(pose)), &other_core)
    {
        return distance_m - radius_m;
    }
    if let Core::Segment(segment) = &other_core
        && let Some(distance_m) = segment_distance_m(&segment_in(segment, &pose.inv_mul(other_pose)), &core)
    {
        return distance_m - other_radius_m;
    }
    // There is an algorithm for every pair of convex solids. Were there none, they would count as touching.
    match query::distance(pose, solid(&core, shape), other_pose, solid(&other_core, other)) {
        Ok(found) if found.distance > 0.0 => found.distance - radius_m - other_radius_m,
        // The cores meet, or the search has come to no end.
        Ok(_) | Err(_) => match query::contact(pose, &**shape, other_pose, &**other, 0.0) {
            Ok(Some(contact)) => contact.dist.min(0.0),
            Ok(None) | Err(_) => 0.0,
        },
    }
}

fn core(shape: &SharedShape) -> (Core<'_>, f32) {
    if let Some(capsule) = shape.as_capsule() {
        (Core::Segment(capsule.segment), capsule.radius)
    } else if let Some(ball) = shape.as_ball() {
        (Core::Segment(Segment::new(Vec3::ZERO, Vec3::ZERO)), ball.radius)
    } else if let Some(cuboid) = shape.as_cuboid() {
        (Core::Cuboid(cuboid.half_extents), 0.0)
    } else if let Some(cylinder) = shape.as_cylinder() {
        (Core::Cylinder { half_height_m: cylinder.half_height, radius_m: cylinder.radius }, 0.0)
    } else {
        (Core::Other(&**shape), 0.0)
    }
}

fn solid<'a>(core: &'a Core<'a>, shape: &'a SharedShape) -> &'a dyn Shape {
    match core {
        Core::Segment(segment) => segment,
        Core::Cuboid(_) | Core::Cylinder { .. } => &**shape,
        Core::Other(shape) => *shape,
    }
}

fn segment_in(segment: &Segment, pose: &Pose3) -> Segment {
    Segment::new(*pose * segment.a, *pose * segment.b)
}

/// Distance from a segment to what it has a method for, in whose frame it is given, metres; 0 if they meet.
fn segment_distance_m(segment: &Segment, core: &Core) -> Option<f32> {
    match *core {
        Core::Cuboid(half_extents) => Some(segment_to_cuboid_m(segment, half_extents)),
        Core::Cylinder { half_height_m, radius_m } => Some(segment_to_cylinder_m(segment, half_height_m, radius_m)),
        Core::Segment(_) | Core::Other(_) => None,
    }
}

/// Distance from a segment to a box about the origin, metres; 0 if they meet.
///
/// Along the segment the squared distance to the box is convex, its slope continuous and made of straight pieces that
/// join where the segment crosses the planes of the box's faces. The slope's zero is found by closing in on it over
/// those crossings, and then on the straight piece that is left.
fn segment_to_cuboid_m(segment: &Segment, half_extents: Vec3) -> f32 {
    let (start, along) = (segment.a, segment.b - segment.a);
    let outside = |t: f32| {
        let point = start + along * t;
        point - point.clamp(-half_extents, half_extents)
    };
    let slope = |t: f32| outside(t).dot(along);
    let (mut low, mut high) = (0.0_f32, 1.0_f32);
    let (mut slope_low, mut slope_high) = (slope(low), slope(high));
    if slope_low >= 0.0 {
        return length(outside(low));
    }
    if slope_high <= 0.0 {
        return length(outside(high));
    }
    for axis in 0..3 {
        for face in [-half_extents[axis], half_extents[axis]] {
            // Parallel to the face: an infinity or not a number, which lies between nothing.
            let crossing = (face - start[axis]) / along[axis];
            if crossing > low && crossing < high {
                let slope = slope(crossing);
                if slope > 0.0 {
                    (high, slope_high) = (crossing, slope);
                } else {
                    (low, slope_low) = (crossing, slope);
                }
            }
        }
    }
    let nearest = low + (high - low) * (-slope_low / (slope_high - slope_low));
    length(outside(nearest))
}

/// Distance from a segment to a cylinder about the y axis, metres; 0 if they meet. As with the box, the slope's zero is
/// closed in on, here by halving.
fn segment_to_cylinder_m(segment: &Segment, half_height_m: f32, radius_m: f32) -> f32 {
    /// A metre becomes 0.03 mm.
    const HALVINGS: u32 = 15;
    let (start, along) = (segment.a, segment.b - segment.a);
    let outside = |t: f32| {
        let point = start + along * t;
        let from_axis = f32::sqrt(point.x * point.x + point.z * point.z);
        let share = if from_axis > radius_m { 1.0 - radius_m / from_axis } else { 0.0 };
        Vec3::new(point.x * share, point.y - point.y.clamp(-half_height_m, half_height_m), point.z * share)
    };
    let slope = |t: f32| outside(t).dot(along);
    let (mut low, mut high) = (0.0_f32, 1.0_f32);
    if slope(low) >= 0.0 {
        return length(outside(low));
    }
    if slope(high) <= 0.0 {
        return length(outside(high));
    }
    for _ in 0..HALVINGS {
        let middle = 0.5 * (low + high);
        let slope = slope(middle);
        if slope > 0.0 {
            high = middle;
        } else if slope < 0.0 {
            low = middle;
        } else {
            return length(outside(middle));
        }
    }
    length(outside(low)).min(length(outside(high)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::physics::geometry::{rotation_x, rotation_y, rotation_z};
    use proptest::prelude::*;

    fn pose() -> impl Strategy<Value = Pose3> {
        let angle = -3.2f32..3.2;
        let place = -0.8f32..0.8;
        ((place.clone(), place.clone(), place), (angle.clone(), angle.clone(), angle)).prop_map(
            |((x, y, z), (a, b, c))| {
                Pose3::from_parts(Vec3::new(x, y, z), rotation_x(a) * rotation_y(b) * rotation_z(c))
            },
        )
    }

    fn shape() -> impl Strategy<Value = SharedShape> {
        let size = 0.01f32..0.3;
        prop_oneof![
            (size.clone(), size.clone(), size.clone()).prop_map(|(x, y, z)| SharedShape::cuboid(x, y, z)),
            (size.clone(), size.clone()).prop_map(|(half_height, radius)| SharedShape::capsule_y(half_height, radius)),
            (size.clone(), size.clone()).prop_map(|(half_height, radius)| SharedShape::cylinder(half_height, radius)),
            size.prop_map(SharedShape::ball),
        ]
    }

    proptest! {
        /// Against points along the axis of what is round, each with its own distance, and for what is not against the
        /// search for the depth.
        #[test]
        fn agrees_with_other_ways_to_measure(one in pose(), other in pose(), a in shape(), b in shape()) {
            let gap = gap_m(&one, &a, &other, &b);
            let (Core::Segment(axis), radius) = core(&a) else {
                if a.as_cuboid().is_some() && b.as_cuboid().is_some() {
                    let reference = query::contact(&one, &*a, &other, &*b, 10.0).unwrap().unwrap().dist;
                    let error = 1e-3 + 1e-2 * reference.abs();
                    prop_assert!((gap - reference).abs() < error, "{gap}, not {reference}");
                }
                return Ok(());
            };
            let sampled = (0..=200u16)
                .map(|k| one * (axis.a + (axis.b - axis.a) * (f32::from(k) / 200.0)))
                .map(|point| b.distance_to_point(&other, point, true))
                .fold(f32::INFINITY, f32::min);
            let spacing = axis.length() / 200.0;
            if sampled > spacing {
                // The search between two round things ends early.
                let error = if b.as_capsule().is_some() { 2e-3 } else { 1e-4 };
                let (low, high) = (sampled - radius - spacing - error, sampled - radius + error);
                prop_assert!(gap >= low && gap <= high, "{gap}, not {low} to {high}");
            } else {
                prop_assert!(gap <= spacing - 0.9 * radius, "the axis goes inside, the gap is {gap}");
            }
        }
    }
}
