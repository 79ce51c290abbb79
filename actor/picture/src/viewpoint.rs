//! A kitchen from outside, for a whole episode: one place from which the way of robot and target is seen best.

use super::camera::{Camera, Projection};
use super::model::Model;
use super::moment::Point;
use super::visible::Visible;
use rapier3d::math::{Pose3, Vec3};
use simulator::physics::geometry::{rotation_x, rotation_y};
use std::f32::consts::TAU;

const TAN_HALF_WIDTH: f32 = 0.42;
const DIRECTIONS: usize = 16;
const PITCHES: [f32; 4] = [0.75, 0.6, 1.05, 1.3];
/// What a less liked angle must show more, as a share of all points.
const PREFERENCE: f32 = 0.06;
/// Room around the points, and the smallest scene, metres.
const MARGIN_M: f32 = 0.2;
const RADIUS_LEAST_M: f32 = 1.2;
/// As wide, for its height, as the page's picture: a square one shows more.
const TRIAL: (usize, usize) = (160, 120);

/// Looks at a ball from outside and sees all of it; what stands between is cut away.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Orbit {
    pub centre: Vec3,
    pub radius_m: f32,
    pub yaw_rad: f32,
    pub pitch_rad: f32,
}

impl Orbit {
    pub fn camera(&self) -> Camera {
        let rotation = rotation_y(self.yaw_rad) * rotation_x(self.pitch_rad);
        let distance_m = self.radius_m * (1.0 + TAN_HALF_WIDTH * TAN_HALF_WIDTH).sqrt() / TAN_HALF_WIDTH;
        let pose = Pose3::from_parts(self.centre - rotation * Vec3::Z * distance_m, rotation);
        Camera::new(pose, Projection::Central { tan_half_width: TAN_HALF_WIDTH }, distance_m - self.radius_m)
    }
}

pub fn best(model: &Model, points: &[Point]) -> Orbit {
    let (low, high) = points.iter().fold((Vec3::splat(f32::MAX), Vec3::splat(f32::MIN)), |(low, high), point| {
        (low.min(point.place), high.max(point.place))
    });
    let centre = 0.5 * (low + high);
    let reach_m = points.iter().map(|point| (point.place - centre).length()).fold(0.0, f32::max);
    let radius_m = (reach_m + MARGIN_M).max(RADIUS_LEAST_M);
    let total: f32 = points.iter().map(|point| point.weight).sum();
    let mut best: Option<(f32, Orbit)> = None;
    for (rank, pitch_rad) in PITCHES.into_iter().enumerate() {
        for direction in 0..DIRECTIONS {
            let yaw_rad = TAU * direction as f32 / DIRECTIONS as f32;
            let orbit = Orbit { centre, radius_m, yaw_rad, pitch_rad };
            let score = seen(model, &orbit.camera(), points) / total - PREFERENCE * rank as f32;
            if best.as_ref().is_none_or(|(highest, _)| score > *highest) {
                best = Some((score, orbit));
            }
        }
    }
    best.expect("there are directions").1
}

fn seen(model: &Model, camera: &Camera, points: &[Point]) -> f32 {
    let (width, height) = TRIAL;
    let corners = model.before(camera).map(|(number, triangle)| (number, triangle.corners));
    let visible = Visible::draw(camera, width, height, corners);
    points.iter().filter(|point| visible.shows(camera, point)).map(|point| point.weight).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use simulator::shape::{Primitive, Shape};

    #[test]
    fn it_looks_from_where_nothing_stands_before_the_points() {
        let mut model = Model::default();
        let block = |x: f32, y: f32, z: f32| Shape::of(Primitive::Cuboid { half_extents_m: Vec3::new(x, y, z) });
        // Walls of a niche that is open towards +x; high, and inside the scene, so that they are not cut away.
        model.add(&block(0.05, 1.0, 0.5), &Pose3::translation(-0.3, 1.0, 0.0), [255; 3], false);
        for z in [-0.3, 0.3] {
            model.add(&block(0.5, 1.0, 0.05), &Pose3::translation(0.0, 1.0, z), [255; 3], false);
        }
        let point = |x: f32, y: f32| Point { place: Vec3::new(x, y, 0.0), weight: 1.0, slack_m: 0.1 };
        let points = [point(0.0, 0.2), point(0.05, 0.3)];
        let camera = best(&model, &points).camera();
        let eye = camera.camera_from_world.inverse().translation;
        assert!(eye.x > eye.z.abs() && eye.y > 0.5, "looks from {eye}");
        assert!((seen(&model, &camera, &points) - 2.0).abs() < 1e-6);
    }
}
