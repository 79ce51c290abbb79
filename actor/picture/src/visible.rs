use super::camera::{Camera, Pixel};
use super::moment::Point;
use rapier3d::math::Vec3;

pub const NOTHING: u32 = u32::MAX;
/// What is nearer by less than this share is as near: of faces in one plane the first one is seen, not parts of both.
const SAME_SHARE: f32 = 1e-4;

#[derive(Debug, Clone)]
pub struct Visible {
    pub width: usize,
    pub height: usize,
    /// Nearness of what a pixel shows (see [`Pixel::nearness`]); negative infinity where there is nothing.
    pub nearness: Vec<f32>,
    pub triangle: Vec<u32>,
}

impl Visible {
    pub fn draw(
        camera: &Camera,
        width: usize,
        height: usize,
        triangles: impl Iterator<Item = (u32, [Vec3; 3])>,
    ) -> Self {
        let mut visible = Self {
            width,
            height,
            nearness: vec![f32::NEG_INFINITY; width * height],
            triangle: vec![NOTHING; width * height],
        };
        for (number, corners) in triangles {
            let corners = corners.map(|corner| camera.camera_from_world * corner);
            let (polygon, count) = clip_near(corners, camera.near_m);
            let pixels = polygon.map(|corner| camera.project(corner, width, height));
            for k in 2..count {
                visible.fill(number, [pixels[0], pixels[k - 1], pixels[k]]);
            }
        }
        visible
    }

    /// Whether a point is in the picture, and nothing before it.
    pub fn shows(&self, camera: &Camera, point: &Point) -> bool {
        let place = camera.camera_from_world * point.place;
        let pixel = camera.project(place, self.width, self.height);
        let inside = (0.0..self.width as f32).contains(&pixel.x) && (0.0..self.height as f32).contains(&pixel.y);
        let nearest_m = || 1.0 / self.nearness[pixel.y as usize * self.width + pixel.x as usize];
        // Nothing at all is infinitely near in the other direction.
        inside && (nearest_m() <= 0.0 || nearest_m() > place.z - point.slack_m)
    }

    fn fill(&mut self, number: u32, [a, b, c]: [Pixel; 3]) {
        let area = (b.x - a.x) * (c.y - a.y) - (c.x - a.x) * (b.y - a.y);
        if area == 0.0 || !area.is_finite() {
            return;
        }
        let slope_x = ((b.nearness - a.nearness) * (c.y - a.y) - (c.nearness - a.nearness) * (b.y - a.y)) / area;
        let slope_y = ((c.nearness - a.nearness) * (b.x - a.x) - (b.nearness - a.nearness) * (c.x - a.x)) / area;
        let lowest = a.y.min(b.y).min(c.y);
        let highest = a.y.max(b.y).max(c.y);
        let first_row = (lowest - 0.5).ceil().max(0.0) as usize;
        let last_row = (highest - 0.5).floor().min(self.height as f32 - 1.0);
        if last_row < 0.0 {
            return;
        }
        for row in first_row..=last_row as usize {
            let y = row as f32 + 0.5;
            let (mut from, mut to) = (0.0_f32, self.width as f32);
            for (p, q) in [(a, b), (b, c), (c, a)] {
                // Inside is where sign · ((q − p) × (pixel − p)) >= 0; along a row that is a bound on x.
                let sign = area.signum();
                let per_x = -sign * (q.y - p.y);
                let rest = sign * ((q.x - p.x) * (y - p.y) + (q.y - p.y) * p.x);
                if per_x > 0.0 {
                    from = from.max(-rest / per_x);
                } else if per_x < 0.0 {
                    to = to.min(-rest / per_x);
                } else if rest < 0.0 {
                    to = -1.0;
                }
            }
            let (first, end) = ((from - 0.5).ceil().max(0.0), (to - 0.5).floor() + 1.0);
            if end <= first {
                continue;
            }
            let line = row * self.width;
            let at_edge = a.nearness + slope_y * (y - a.y) - slope_x * (a.x - 0.5);
            for column in first as usize..(end as usize).min(self.width) {
                let nearness = at_edge + slope_x * column as f32;
                let before = self.nearness[line + column];
                if nearness > before + SAME_SHARE * before.abs() || before == f32::NEG_INFINITY {
                    self.nearness[line + column] = nearness;
                    self.triangle[line + column] = number;
                }
            }
        }
    }
}

/// The part of a triangle beyond the near plane: up to four corners and their number.
fn clip_near(corners: [Vec3; 3], near_m: f32) -> ([Vec3; 4], usize) {
    let mut out = [Vec3::ZERO; 4];
    let mut count = 0;
    for (i, &p) in corners.iter().enumerate() {
        let q = corners[(i + 1) % 3];
        if p.z >= near_m {
            out[count] = p;
            count += 1;
        }
        if (p.z >= near_m) != (q.z >= near_m) {
            out[count] = p + (q - p) * ((near_m - p.z) / (q.z - p.z));
            count += 1;
        }
    }
    // Corners that are not there must still be projected without a division by zero.
    for corner in &mut out[count..] {
        *corner = Vec3::new(0.0, 0.0, near_m.max(1.0));
    }
    (out, count)
}

#[cfg(test)]
mod tests {
    use super::super::camera::Projection;
    use super::*;
    use rapier3d::math::Pose3;

    fn camera(near_m: f32) -> Camera {
        Camera::new(Pose3::identity(), Projection::Parallel { half_width_m: 1.0 }, near_m)
    }

    #[test]
    fn a_triangle_covers_its_area_and_hides_what_is_behind() {
        let at = |z: f32| [Vec3::new(-1.0, -1.0, z), Vec3::new(1.0, -1.0, z), Vec3::new(-1.0, 1.0, z)];
        let visible = Visible::draw(&camera(0.1), 100, 100, [(0, at(2.0)), (1, at(1.0)), (2, at(3.0))].into_iter());
        let shown = visible.triangle.iter().filter(|&&number| number == 1).count();
        assert!((shown as i32 - 5000).abs() <= 100, "{shown} pixels of 5000");
        assert_eq!(visible.triangle.iter().filter(|&&number| number == NOTHING).count(), 10_000 - shown);
        assert!(visible.nearness.iter().all(|&nearness| nearness == f32::NEG_INFINITY || nearness == -1.0));
    }

    #[test]
    fn what_is_nearer_than_the_near_plane_is_cut_away() {
        // A slope from z = 0 at the left to z = 2 at the right: half of it remains.
        let slope = [
            [Vec3::new(-1.0, -1.0, 0.0), Vec3::new(1.0, -1.0, 2.0), Vec3::new(-1.0, 1.0, 0.0)],
            [Vec3::new(1.0, -1.0, 2.0), Vec3::new(1.0, 1.0, 2.0), Vec3::new(-1.0, 1.0, 0.0)],
        ];
        let visible = Visible::draw(&camera(1.0), 100, 100, (0..).zip(slope));
        for (index, &number) in visible.triangle.iter().enumerate() {
            assert_eq!(number == NOTHING, index % 100 < 50, "pixel {index}");
        }
    }
}
