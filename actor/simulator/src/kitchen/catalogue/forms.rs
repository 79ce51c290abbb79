//! Forms that many things share, standing on y = 0: boxes, turned bodies, bottles, basins, handles.

use crate::physics::geometry::{rotation_x, rotation_y, rotation_z};
use crate::shape::{Primitive, Shape};
use rapier3d::math::{Pose3, Vec3};
use std::f32::consts::PI;

/// A turned thing's foot stands out below it this far, metres.
const FOOT_M: f32 = 0.002;
const SIDES: u32 = 16;

/// A box of this size about its origin.
pub fn cuboid(x_m: f32, y_m: f32, z_m: f32) -> Primitive {
    Primitive::Cuboid { half_extents_m: 0.5 * Vec3::new(x_m, y_m, z_m) }
}

/// A cylinder about y, about its origin.
pub fn cylinder(radius_m: f32, height_m: f32) -> Primitive {
    Primitive::Cylinder { radius_m, half_height_m: 0.5 * height_m }
}

/// A capsule about y of this whole length, about its origin.
pub fn capsule(radius_m: f32, length_m: f32) -> Primitive {
    Primitive::Capsule { radius_m, half_height_m: 0.5 * length_m - radius_m }
}

pub fn ball(radius_m: f32) -> Primitive {
    Primitive::Sphere { radius_m }
}

/// The pose of something along y that is to lie along x.
pub fn along_x(x_m: f32, y_m: f32, z_m: f32) -> Pose3 {
    Pose3::from_parts(Vec3::new(x_m, y_m, z_m), rotation_z(0.5 * PI))
}

/// The pose of something along y that is to lie along z.
pub fn along_z(x_m: f32, y_m: f32, z_m: f32) -> Pose3 {
    Pose3::from_parts(Vec3::new(x_m, y_m, z_m), rotation_x(0.5 * PI))
}

/// The pose of something turned about x by this angle.
pub fn pitched(x_m: f32, y_m: f32, z_m: f32, angle_rad: f32) -> Pose3 {
    Pose3::from_parts(Vec3::new(x_m, y_m, z_m), rotation_x(angle_rad))
}

/// The pose of something turned about y by this angle.
pub fn yawed(x_m: f32, y_m: f32, z_m: f32, angle_rad: f32) -> Pose3 {
    Pose3::from_parts(Vec3::new(x_m, y_m, z_m), rotation_y(angle_rad))
}

/// The pose of something turned about z by this angle.
pub fn rolled(x_m: f32, y_m: f32, z_m: f32, angle_rad: f32) -> Pose3 {
    Pose3::from_parts(Vec3::new(x_m, y_m, z_m), rotation_z(angle_rad))
}

pub fn block(x_m: f32, y_m: f32, z_m: f32) -> Shape {
    Shape::default().with(cuboid(x_m, y_m, z_m), 0.0, 0.5 * y_m, 0.0)
}

pub fn upright(radius_m: f32, height_m: f32) -> Shape {
    Shape::default().with(cylinder(radius_m, height_m), 0.0, 0.5 * height_m, 0.0)
}

fn corner(radius_m: f32, height_m: f32, side: u32, sides: u32, stretch_x: f32) -> Vec3 {
    let (sin, cos) = libm::sincosf(2.0 * PI * side as f32 / sides as f32);
    Vec3::new(stretch_x * radius_m * cos, height_m, radius_m * sin)
}

/// The convex hull of rings (radius, height) about the y axis, stretched along x.
pub fn spun(rings: &[(f32, f32)], stretch_x: f32) -> Primitive {
    let points_m = rings
        .iter()
        .flat_map(|&(radius, height)| (0..SIDES).map(move |side| corner(radius, height, side, SIDES, stretch_x)))
        .collect();
    Primitive::Hull { points_m }
}

/// The convex hull of a polygon in the x-y plane, drawn out along z by this much about z = 0.
pub fn prism(profile: &[(f32, f32)], depth_m: f32) -> Primitive {
    let points_m = profile.iter().flat_map(|&(x, y)| [-0.5, 0.5].map(|side| Vec3::new(x, y, side * depth_m))).collect();
    Primitive::Hull { points_m }
}

/// A turned body (see [`spun`]) on a low round foot. The foot bears: a hull's underside is several triangles to the
/// contact solver, which then rocks on one of them.
pub fn lathe(rings: &[(f32, f32)]) -> Shape {
    oval(rings, 1.0)
}

/// As [`lathe`], stretched along x.
pub fn oval(rings: &[(f32, f32)], stretch_x: f32) -> Shape {
    let (foot_m, _) = rings[0];
    Shape::of(spun(rings, stretch_x)).with(cylinder(foot_m, 2.0 * FOOT_M), 0.0, 0.0, 0.0)
}

/// A fruit: a ball of this radius and height with a flat underside, stretched along x.
pub fn fruit(radius_m: f32, height_m: f32, stretch_x: f32) -> Shape {
    let rings = [(0.50, 0.0), (0.82, 0.13), (1.0, 0.45), (0.9, 0.72), (0.62, 0.91), (0.2, 1.0)];
    oval(&rings.map(|(radius, height)| (radius * radius_m, height * height_m)), stretch_x)
}

pub fn bottle(radius_m: f32, height_m: f32, neck_radius_m: f32, neck_m: f32) -> Shape {
    let shoulder_m = 0.25 * neck_m;
    let shoulder = spun(&[(radius_m, 0.0), (neck_radius_m, shoulder_m)], 1.0);
    upright(radius_m, height_m).with(shoulder, 0.0, height_m, 0.0).with(
        cylinder(neck_radius_m, neck_m),
        0.0,
        height_m + 0.5 * neck_m,
        0.0,
    )
}

/// A jar or can: body and a lid that is a little wider or narrower.
pub fn jar(radius_m: f32, height_m: f32, lid_radius_m: f32, lid_m: f32) -> Shape {
    upright(radius_m, height_m).with(cylinder(lid_radius_m, lid_m), 0.0, height_m + 0.5 * lid_m, 0.0)
}

/// An open round vessel: a floor, and a wall of convex segments that leans outward.
pub fn basin(radius_low_m: f32, radius_high_m: f32, height_m: f32, wall_m: f32, segments: u32) -> Shape {
    let floor_m = wall_m.max(0.004);
    let mut shape = upright(radius_low_m, floor_m);
    for segment in 0..segments {
        let points_m = [segment, segment + 1]
            .into_iter()
            .flat_map(|side| {
                [
                    corner(radius_low_m, 0.5 * floor_m, side, segments, 1.0),
                    corner(radius_low_m - wall_m, 0.5 * floor_m, side, segments, 1.0),
                    corner(radius_high_m, height_m, side, segments, 1.0),
                    corner(radius_high_m - wall_m, height_m, side, segments, 1.0),
                ]
            })
            .collect();
        shape = shape.with(Primitive::Hull { points_m }, 0.0, 0.0, 0.0);
    }
    shape
}

pub fn open_box(x_m: f32, y_m: f32, z_m: f32, wall_m: f32) -> Shape {
    let (side_x, side_z) = (0.5 * (x_m - wall_m), 0.5 * (z_m - wall_m));
    block(x_m, wall_m, z_m)
        .with(cuboid(wall_m, y_m, z_m), side_x, 0.5 * y_m, 0.0)
        .with(cuboid(wall_m, y_m, z_m), -side_x, 0.5 * y_m, 0.0)
        .with(cuboid(x_m, y_m, wall_m), 0.0, 0.5 * y_m, side_z)
        .with(cuboid(x_m, y_m, wall_m), 0.0, 0.5 * y_m, -side_z)
}

/// A handle on the +x side: two arms and a grip, from `x_m` outward by `reach_m`, centred at `y_m`.
pub fn handle(x_m: f32, y_m: f32, reach_m: f32, height_m: f32, thickness_m: f32) -> Shape {
    let arm = cuboid(reach_m, thickness_m, 1.2 * thickness_m);
    let arm_y_m = 0.5 * (height_m - thickness_m);
    let middle_m = x_m + 0.5 * reach_m;
    Shape::default().with(arm.clone(), middle_m, y_m + arm_y_m, 0.0).with(arm, middle_m, y_m - arm_y_m, 0.0).with(
        capsule(0.6 * thickness_m, height_m),
        x_m + reach_m,
        y_m,
        0.0,
    )
}

/// Four straight legs at (±x, ±z).
pub fn legs(thickness_m: f32, height_m: f32, x_m: f32, z_m: f32) -> Shape {
    [(x_m, z_m), (-x_m, z_m), (x_m, -z_m), (-x_m, -z_m)].into_iter().fold(Shape::default(), |shape, (x, z)| {
        shape.with(cuboid(thickness_m, height_m, thickness_m), x, 0.5 * height_m, z)
    })
}

/// The pose of something along y that is to lie flat, turned away from x by this angle about y.
pub fn lying(x_m: f32, y_m: f32, z_m: f32, angle_rad: f32) -> Pose3 {
    Pose3::from_parts(Vec3::new(x_m, y_m, z_m), rotation_y(-angle_rad) * rotation_z(0.5 * PI))
}
