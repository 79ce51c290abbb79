//! The robot as pictures from outside show it: a base, a mast with a head, an arm with joints, and a magnet.
//!
//! Only people see it so. What collides, and what the depth camera sees, are the capsules of
//! [`simulator::robot::links`]; each piece lies in or at one of them.

use super::canvas::Rgb;
use super::palette;
use rapier3d::math::{Pose3, Rot3, Vec3};
use simulator::robot::links::{HAND, PartPoses, part_shapes};
use simulator::shape::{Part, Primitive, Shape};
use std::f32::consts::{FRAC_1_SQRT_2, PI};

const DARK: Rgb = [62, 66, 74];
const LIGHT: Rgb = [212, 214, 218];
/// The hand while it holds something.
pub const HOLDS: Rgb = [255, 200, 0];
/// Half of the base's height, the radii of the mast and of the arm's carriage, half of the head's sizes, metres.
const BASE_M: f32 = 0.1;
const MAST_M: f32 = 0.055;
const CARRIAGE_M: f32 = 0.085;
const HEAD_M: Vec3 = Vec3::new(0.09, 0.05, 0.07);
/// Radius of the camera's lens, which looks out of the head's front.
const LENS_M: f32 = 0.032;
/// Thickness of a link, of its capsule's.
const LINK: f32 = 0.75;
/// The floor about the base is darker: by this share at it, and up to this distance, metres.
const SHADOW: f32 = 0.5;
const SHADOW_M: f32 = 0.3;
/// How far from the base's underside the floor is, metres.
const FLOOR_M: f32 = 0.05;
/// Of the magnet, whose core is smaller and which reaches further, metres.
const BALL_M: f32 = 0.052;
/// A link's shadow is that of so many balls along it, and so much deeper than an even sky's, since lamps hang above.
const BALLS: u8 = 6;
const DEEPER: f32 = 1.6;
/// The share of the light that all of them take at most, and how far they are minded, metres.
const TAKEN_MOST: f32 = 0.55;
const MINDED_M: f32 = 0.5;

pub struct Piece {
    pub shape: Shape,
    /// The part that it moves with.
    pub part: usize,
    pub colour: Rgb,
}

/// Radius and half of the straight part's height of a collision capsule, metres.
fn capsule(part: &Shape) -> (f32, f32) {
    match part.parts[0].primitive {
        Primitive::Capsule { radius_m, half_height_m } => (radius_m, half_height_m),
        _ => (0.0, 0.0),
    }
}

/// Share of the light on a place that the robot leaves, by the place and its normal: its base darkens the floor about
/// it, its arm what is below it.
pub fn shadow(poses: &PartPoses) -> impl Fn(Vec3, Vec3) -> f32 + use<> {
    let (radius_m, half_height_m) = capsule(&part_shapes()[0]);
    let middle = poses[0].translation;
    let arm = balls(poses);
    let (low, high) = arm.iter().fold((arm[0].0, arm[0].0), |(low, high), (at, _)| (low.min(*at), high.max(*at)));
    move |place, normal| {
        let is_near = (place - place.clamp(low, high)).length_squared() < MINDED_M * MINDED_M;
        let taken: f32 = arm.iter().filter(|_| is_near).map(|(at, size)| covers(*at - place, normal, *size)).sum();
        let way = place - middle;
        let is_floor = normal.y >= 0.9 && (way.y + half_height_m + radius_m).abs() <= FLOOR_M;
        let near = if is_floor { 1.0 - (libm::hypotf(way.x, way.z) - radius_m) / SHADOW_M } else { 0.0 };
        (1.0 - (DEEPER * taken).min(TAKEN_MOST)) * (1.0 - SHADOW * near.clamp(0.0, 1.0).powi(2))
    }
}

/// The share of an even sky that a ball of this squared radius covers, weighted by its slant.
fn covers(way: Vec3, normal: Vec3, size_m2: f32) -> f32 {
    let far_m2 = way.length_squared().max(size_m2);
    normal.dot(way).max(0.0) * size_m2 / (far_m2 * far_m2.sqrt())
}

/// The arm as balls: where each is, and its squared radius, so that together they cover what the links cover.
fn balls(poses: &PartPoses) -> Vec<(Vec3, f32)> {
    let links = part_shapes().into_iter().zip(poses).take(HAND).skip(1);
    let mut balls: Vec<_> = links
        .flat_map(|(shape, pose)| {
            let (radius_m, half_m) = capsule(&shape);
            let step_m = 2.0 * half_m / f32::from(BALLS);
            let size_m2 = 2.0 * LINK * radius_m * step_m / PI;
            (0..BALLS).map(move |at| (*pose * Vec3::new(0.0, 0.0, -step_m * (f32::from(at) + 0.5)), size_m2))
        })
        .collect();
    balls.push((poses[HAND].translation, BALL_M * BALL_M));
    balls
}

pub fn pieces() -> Vec<Piece> {
    let shapes = part_shapes();
    let mut pieces = Vec::new();
    let mut add = |part: usize, primitive: Primitive, body_from_part: Pose3, colour: Rgb| {
        let shape = Shape { parts: vec![Part { primitive, body_from_part }] };
        pieces.push(Piece { shape, part, colour });
    };
    let up = |y: f32| Pose3::translation(0.0, y, 0.0);
    let along_z = Rot3::from_xyzw(FRAC_1_SQRT_2, 0.0, 0.0, FRAC_1_SQRT_2);

    let (radius_m, half_height_m) = capsule(&shapes[0]);
    let top = half_height_m + radius_m;
    let mast = top - BASE_M - HEAD_M.y;
    add(0, Primitive::Cylinder { radius_m, half_height_m: BASE_M }, up(BASE_M - top), DARK);
    add(0, Primitive::Cylinder { radius_m: MAST_M, half_height_m: mast }, up(BASE_M - HEAD_M.y), LIGHT);
    add(0, Primitive::Cuboid { half_extents_m: HEAD_M }, up(top - HEAD_M.y), palette::ROBOT);
    let front = Pose3::translation(0.0, top - HEAD_M.y, HEAD_M.z);
    add(0, Primitive::Sphere { radius_m: LENS_M }, front, DARK);

    for (part, shape) in shapes.iter().enumerate().take(HAND).skip(1) {
        let (thick_m, half_m) = capsule(shape);
        // The shoulder's begins at the mast, deep in the body, in a carriage around it.
        let half_m = if part == 1 { half_m + 0.5 * radius_m } else { half_m };
        if part == 1 {
            let shoulder = Pose3::translation(0.0, 0.0, -2.0 * half_m);
            add(part, Primitive::Sphere { radius_m: CARRIAGE_M }, shoulder, palette::ROBOT);
        }
        let middle = Pose3::from_parts(Vec3::new(0.0, 0.0, -half_m), along_z);
        add(part, Primitive::Capsule { radius_m: LINK * thick_m, half_height_m: half_m }, middle, LIGHT);
        if part + 1 < HAND {
            add(part, Primitive::Sphere { radius_m: thick_m }, up(0.0), palette::ROBOT);
        }
    }
    add(HAND, Primitive::Sphere { radius_m: BALL_M }, up(0.0), DARK);
    pieces
}

#[cfg(test)]
mod tests {
    use super::super::model::Model;
    use super::*;
    use simulator::robot::configuration::Configuration;
    use simulator::robot::links::part_poses;

    #[test]
    fn what_is_below_the_arm_is_darker_and_what_is_above_it_is_not() {
        let poses = part_poses(&Configuration::start(0.0, 0.0, 0).posture()).unwrap();
        let shadow = shadow(&poses);
        let at = |x: f32, y: f32| shadow(poses[HAND].translation + Vec3::new(x, y, 0.0), Vec3::Y);
        let [under, beside, far] = [0.0, 0.2, 0.8].map(|x| at(x, -0.15));
        assert!(under < 0.9 && under < beside && beside < 1.0, "{under} {beside}");
        assert_eq!([far, at(0.0, 0.6)], [1.0; 2]);
    }

    #[test]
    fn the_hand_has_another_colour_while_it_holds() {
        let poses = part_poses(&Configuration::start(0.0, 0.0, 0).posture()).unwrap();
        let colours = [false, true].map(|is_holding| {
            let mut model = Model::default();
            model.add_robot(&poses, true, is_holding);
            model.colours
        });
        let [empty, holds] = &colours;
        let changed: Vec<_> = empty.iter().zip(holds).filter(|(one, other)| one != other).collect();
        assert_eq!(changed, [(&DARK, &HOLDS)]);
    }

    #[test]
    fn what_is_drawn_is_where_the_robot_collides() {
        let poses = part_poses(&Configuration::start(0.5, -0.25, 3).posture()).unwrap();
        let (mut collides, mut drawn) = (Model::default(), Model::default());
        part_shapes().iter().zip(&poses).for_each(|(shape, pose)| collides.add(shape, pose, LIGHT, false));
        drawn.add_robot(&poses, true, false);
        let ((low, high), (drawn_low, drawn_high)) = (collides.bounds(), drawn.bounds());
        let reach = Vec3::splat(0.03);
        assert!((drawn_low - low + reach).min_element() > 0.0, "{drawn_low} from {low}");
        assert!((high - drawn_high + reach).min_element() > 0.0, "{drawn_high} to {high}");
        assert!((drawn_low.y - low.y).abs() < 1e-3 && (drawn_high.y - high.y).abs() < 1e-3, "as tall as it is");
    }
}
