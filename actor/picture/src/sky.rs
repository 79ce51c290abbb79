//! Soft light from all over: a dome of many distant lamps, each with a picture of what it reaches.
//!
//! The share of the dome that a point sees is its ambient occlusion, exact up to the number of lamps and the size of
//! their pixels: what stands on something darkens it, and corners are dark.

use super::camera::{Camera, Projection};
use super::model::Model;
use super::visible::Visible;
use rapier3d::math::{Pose3, Rot3, Vec3};
use std::borrow::Borrow;
use std::f32::consts::PI;

const LAMPS: usize = 96;
/// Lowest lamp: sine of its elevation.
const LOWEST: f32 = 0.12;
/// Width and height of a lamp's picture; of a dome's, which keeps many, pixels.
const SIDE: usize = 640;
const DOME_SIDE: usize = 400;
/// A point is lifted this far off its own surface before it is looked up, metres ...
const LIFT_M: f32 = 0.012;
/// ... and counts as hidden only by what is this much nearer to the lamp, metres.
const SLACK_M: f32 = 0.012;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lit {
    pub point: Vec3,
    pub normal: Vec3,
    /// Nothing stands between it and the lamps.
    pub open: bool,
}

/// Light that falls onto each point: 1 for a floor under the open dome. Lamp after lamp, so that only one lamp's
/// picture is held at a time.
pub fn light(model: &Model, points: &[Lit]) -> Vec<f32> {
    shine((0..LAMPS).map(|index| Lamp::hung(model, index, LAMPS, SIDE)), points)
}

/// Fewer lamps whose pictures are kept, for many pictures of one scene; enough that no single shadow has an edge.
pub struct Dome(Vec<Lamp>);

impl Dome {
    pub fn over(model: &Model, lamps: usize) -> Self {
        Self((0..lamps).map(|index| Lamp::hung(model, index, lamps, DOME_SIDE)).collect())
    }

    pub fn light(&self, points: &[Lit]) -> Vec<f32> {
        shine(self.0.iter(), points)
    }
}

fn shine(lamps: impl Iterator<Item = impl Borrow<Lamp>>, points: &[Lit]) -> Vec<f32> {
    let mut sums = vec![0.0_f32; points.len()];
    let mut full = 0.0;
    for lamp in lamps {
        let lamp = lamp.borrow();
        for (sum, lit) in sums.iter_mut().zip(points) {
            let slant = lit.normal.dot(lamp.towards);
            if slant > 0.0 {
                *sum += slant * if lit.open { 1.0 } else { lamp.reaches(lit.point + lit.normal * LIFT_M) };
            }
        }
        full += lamp.up;
    }
    sums.iter().map(|sum| sum / full).collect()
}

struct Lamp {
    /// Where it hangs, seen from below; its height there.
    towards: Vec3,
    up: f32,
    camera: Camera,
    side: usize,
    nearness: Vec<f32>,
}

impl Lamp {
    fn hung(model: &Model, index: usize, count: usize, side: usize) -> Self {
        let (low, high) = model.bounds();
        let (centre, radius) = (0.5 * (low + high), 0.5 * (high - low).length());
        // A spiral with equal steps in height is uniform over the sphere (Archimedes), and the golden angle keeps
        // its turns apart.
        let up = LOWEST + (1.0 - LOWEST) * (index as f32 + 0.5) / count as f32;
        let (sin, cos) = libm::sincosf(PI * (3.0 - 5.0_f32.sqrt()) * index as f32);
        let flat = (1.0 - up * up).sqrt();
        let towards = Vec3::new(flat * cos, up, flat * sin);
        let rotation = Rot3::from_rotation_arc(Vec3::Z, -towards);
        let pose = Pose3::from_parts(centre + towards * (radius + 0.1), rotation);
        let camera = Camera::new(pose, Projection::Parallel { half_width_m: radius }, 0.0);
        let nearness = Visible::draw(&camera, side, side, (0..).zip(model.corners())).nearness;
        Self { towards, up, camera, side, nearness }
    }

    /// Share of the four pixels about a point that the lamp sees through to it, weighted by nearness in the picture.
    fn reaches(&self, point: Vec3) -> f32 {
        let side = self.side;
        let pixel = self.camera.project(self.camera.camera_from_world * point, side, side);
        let limit = (side - 2) as f32;
        let (x, y) = ((pixel.x - 0.5).clamp(0.0, limit), (pixel.y - 0.5).clamp(0.0, limit));
        let (column, row) = (x as usize, y as usize);
        let (along, down) = (x - column as f32, y - row as f32);
        let at = row * side + column;
        let seen = |index: usize| f32::from(u8::from(self.nearness[index] <= pixel.nearness + SLACK_M));
        let above = seen(at) * (1.0 - along) + seen(at + 1) * along;
        let below = seen(at + side) * (1.0 - along) + seen(at + side + 1) * along;
        above * (1.0 - down) + below * down
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use simulator::shape::{Primitive, Shape};

    #[test]
    fn an_open_floor_is_bright_and_the_floor_beside_a_wall_is_not() {
        let mut model = Model::default();
        let block = |x: f32, y: f32, z: f32| Shape::of(Primitive::Cuboid { half_extents_m: Vec3::new(x, y, z) });
        model.add(&block(4.0, 0.05, 4.0), &Pose3::translation(0.0, -0.05, 0.0), [255; 3], false);
        model.add(&block(0.05, 2.0, 4.0), &Pose3::translation(-1.05, 2.0, 0.0), [255; 3], false);
        let at = |x: f32| Lit { point: Vec3::new(x, 0.0, 0.0), normal: Vec3::Y, open: false };
        let light = light(&model, &[at(3.8), at(-0.95), at(-1.05)]);
        assert!(light[0] > 0.9, "far from the wall: {}", light[0]);
        // A high wall hides half of the dome.
        assert!((light[1] - 0.5).abs() < 0.1, "beside it: {}", light[1]);
        assert!(light[2] < 0.05, "under it: {}", light[2]);
        assert_eq!(super::light(&model, &[Lit { open: true, ..at(-1.05) }]), [1.0]);
    }
}
