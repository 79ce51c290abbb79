//! A kitchen from outside, for a whole episode: one place from which the way of robot and target is seen best.

use super::camera::{Camera, Projection};
use super::model::Model;
use super::moment::Point;
use super::visible::{NOTHING, Visible};
use rapier3d::math::{Pose3, Vec3};
use simulator::physics::geometry::{rotation_x, rotation_y};
use std::f32::consts::TAU;

const TAN_HALF_WIDTH: f32 = 0.42;
const DIRECTIONS: usize = 16;
const PITCHES: [f32; 4] = [0.75, 0.6, 1.05, 1.3];
/// What a less liked angle must show more, as a share of all points.
const PREFERENCE: f32 = 0.06;
/// What a picture loses, in the same share: for a metre more of radius, and where all of it lies beyond the room.
const FARTHER: f32 = 0.05;
const BARE: f32 = 0.4;
/// Room between the points and each edge of the picture, as a share of it, and around each point, metres.
const MARGIN: f32 = 0.12;
const MARGIN_M: f32 = 0.05;
/// The smallest scene, metres.
const RADIUS_LEAST_M: f32 = 1.0;
const TRIAL_WIDTH: usize = 160;

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
        let distance_m = self.radius_m / sine();
        let pose = Pose3::from_parts(self.centre - rotation * Vec3::Z * distance_m, rotation);
        Camera::new(pose, Projection::Central { tan_half_width: TAN_HALF_WIDTH }, distance_m - self.radius_m)
    }
}

/// Of half the angle that a picture is wide: radius of a ball that fills it, for a distance of 1.
fn sine() -> f32 {
    TAN_HALF_WIDTH / (1.0 + TAN_HALF_WIDTH * TAN_HALF_WIDTH).sqrt()
}

/// The nearest camera in this direction that has all points in its picture, which is `tall` as a share of its width, with
/// room around them.
fn around(points: &[Point], yaw_rad: f32, pitch_rad: f32, tall: f32) -> Orbit {
    let rotation = rotation_y(yaw_rad) * rotation_x(pitch_rad);
    let turned: Vec<Vec3> = points.iter().map(|point| rotation.inverse() * point.place).collect();
    let bounds = |of: &dyn Fn(&Vec3) -> f32| {
        turned.iter().map(of).fold((f32::MAX, f32::MIN), |(low, high), value| (low.min(value), high.max(value)))
    };
    // Along an axis of the picture: the place that has as much room on both sides, and the farthest depth from which all
    // of it is seen.
    let fit = |across: &dyn Fn(&Vec3) -> f32, tan: f32| {
        let tan = (1.0 - 2.0 * MARGIN) * tan;
        let low = bounds(&|place| across(place) + tan * place.z).0 - MARGIN_M;
        let high = bounds(&|place| across(place) - tan * place.z).1 + MARGIN_M;
        (0.5 * (low + high), (low - high) / (2.0 * tan))
    };
    let (x, of_width) = fit(&|place| place.x, TAN_HALF_WIDTH);
    let (y, of_height) = fit(&|place| place.y, tall * TAN_HALF_WIDTH);
    let eye = of_width.min(of_height);
    let (nearest, farthest) = bounds(&|place| place.z);
    // No point is nearer than what is cut away.
    let uncut = (nearest - MARGIN_M - eye) / (1.0 - sine());
    let distance_m = (0.5 * (nearest + farthest) - eye).min(uncut);
    let radius_m = (distance_m * sine()).max(RADIUS_LEAST_M);
    Orbit { centre: rotation * Vec3::new(x, y, eye + distance_m), radius_m, yaw_rad, pitch_rad }
}

/// The camera from which most is seen in pictures whose height is `tall`, as a share of their width.
pub fn best(model: &Model, points: &[Point], tall: f32) -> Orbit {
    let total: f32 = points.iter().map(|point| point.weight).sum();
    let mut best: Option<(f32, Orbit)> = None;
    for (rank, pitch_rad) in PITCHES.into_iter().enumerate() {
        for direction in 0..DIRECTIONS {
            let orbit = around(points, TAU * direction as f32 / DIRECTIONS as f32, pitch_rad, tall);
            let lost = PREFERENCE * rank as f32 + FARTHER * orbit.radius_m;
            let is_better = |score: f32| best.as_ref().is_none_or(|(highest, _)| score > *highest);
            // Most time is spent on drawing: an angle is not drawn that would lose even with all points seen.
            if !is_better(1.0 - lost) {
                continue;
            }
            let (seen, bare) = seen(model, &orbit.camera(), points, tall);
            let score = seen / total - (lost + BARE * bare);
            if is_better(score) {
                best = Some((score, orbit));
            }
        }
    }
    best.expect("there are directions").1
}

/// Weight of the points that are seen, and share of the picture beyond the room.
fn seen(model: &Model, camera: &Camera, points: &[Point], tall: f32) -> (f32, f32) {
    let (width, height) = (TRIAL_WIDTH, (tall * TRIAL_WIDTH as f32) as usize);
    let corners = model.before(camera).map(|(number, triangle)| (number, triangle.corners));
    let visible = Visible::draw(camera, width, height, corners);
    let bare = visible.triangle.iter().filter(|&&triangle| triangle == NOTHING).count();
    let weight = points.iter().filter(|point| visible.shows(camera, point)).map(|point| point.weight).sum();
    (weight, bare as f32 / visible.triangle.len() as f32)
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
        let camera = best(&model, &points, 0.75).camera();
        let eye = camera.camera_from_world.inverse().translation;
        assert!(eye.x > eye.z.abs() && eye.y > 0.5, "looks from {eye}");
        assert!((seen(&model, &camera, &points, 0.75).0 - 2.0).abs() < 1e-6);
    }

    /// A ball around the points is as high as it is wide, and a picture is not.
    #[test]
    fn a_picture_holds_all_points_and_no_more_than_it_has_to() {
        let point = |x: f32, y: f32, z: f32| Point { place: Vec3::new(x, y, z), weight: 1.0, slack_m: 0.1 };
        for points in [
            [point(0.0, 0.0, 0.0), point(0.0, 1.7, 0.0), point(0.6, 1.0, 0.4)],
            [point(-2.0, 0.0, 1.0), point(2.5, 1.7, 0.0), point(0.6, 1.0, 3.0)],
        ] {
            for (yaw_rad, pitch_rad, tall) in [(0.0, 0.6, 0.75), (2.0, 0.75, 1.0), (4.5, 1.3, 0.75)] {
                let orbit = around(&points, yaw_rad, pitch_rad, tall);
                let camera_from_world = orbit.camera().camera_from_world;
                let at = points.map(|point| camera_from_world * point.place);
                let within = |share: fn(Vec3) -> f32| at.map(share).into_iter().fold(0.0, f32::max);
                let wide = within(|place| place.x.abs() / place.z / TAN_HALF_WIDTH);
                let high = within(|place| place.y.abs() / place.z / TAN_HALF_WIDTH) / tall;
                let inner = 1.0 - 2.0 * MARGIN;
                assert!(wide < inner && high < inner, "{orbit:?}: {wide} {high}");
                assert!(wide.max(high) > 0.9 * inner || orbit.radius_m <= RADIUS_LEAST_M, "{orbit:?}: {wide} {high}");
                let cut = orbit.radius_m / sine() - orbit.radius_m;
                assert!(at.iter().all(|place| place.z > cut), "{orbit:?}");
            }
        }
    }
}
