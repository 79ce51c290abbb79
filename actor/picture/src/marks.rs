use super::camera::{Camera, Pixel};
use super::canvas::{Canvas, Rgb};
use rapier3d::math::Vec3;

pub const TARGET: Rgb = [232, 0, 132];
pub const GOAL: Rgb = [0, 176, 88];
/// What is drawn hidden if something is this much nearer, metres.
const SLACK_M: f32 = 0.02;
/// Length of the dashes of a hidden line and of the gaps between them, line widths.
const DASH: f32 = 2.0;
const EDGES: [(usize, usize); 12] =
    [(0, 1), (2, 3), (4, 5), (6, 7), (0, 2), (1, 3), (4, 6), (5, 7), (0, 4), (1, 5), (2, 6), (3, 7)];

pub struct Marks<'a, D: Fn(usize, usize) -> f32> {
    camera: &'a Camera,
    depth_m: D,
    width: usize,
    height: usize,
    line_px: f32,
    cover: Vec<f32>,
}

impl<'a, D: Fn(usize, usize) -> f32> Marks<'a, D> {
    pub fn new(camera: &'a Camera, width: usize, height: usize, depth_m: D) -> Self {
        let line_px = (width as f32 / 220.0).max(1.5);
        Self { camera, depth_m, width, height, line_px, cover: vec![0.0; width * height] }
    }

    pub fn cube(&mut self, centre: Vec3, half_m: f32) {
        let corner = |bits: usize| {
            let side = |bit: usize| if bits >> bit & 1 == 1 { half_m } else { -half_m };
            centre + Vec3::new(side(0), side(1), side(2))
        };
        for (from, to) in EDGES {
            self.edge(corner(from), corner(to));
        }
    }

    /// A ring about a point, at least as wide as a ball of this radius; dashed where the point is hidden by more than
    /// the ball itself.
    pub fn ring(&mut self, centre: Vec3, radius_m: f32) {
        let centre = self.camera.camera_from_world * centre;
        if centre.z < self.camera.near_m.max(radius_m) {
            return;
        }
        let middle = self.camera.project(centre, self.width, self.height);
        let rim = self.camera.project(centre + Vec3::new(radius_m, 0.0, 0.0), self.width, self.height);
        let radius_px = (rim.x - middle.x).max(7.0 * self.line_px);
        let visible = self.shown(middle, centre.z - radius_m);
        let steps = (radius_px * 8.0) as usize;
        for step in 0..steps {
            let angle = std::f32::consts::TAU * step as f32 / steps as f32;
            let (sin, cos) = libm::sincosf(angle);
            if visible || self.dash(angle * radius_px) {
                self.dot(middle.x + radius_px * cos, middle.y + radius_px * sin);
            }
        }
    }

    pub fn lay(&self, canvas: &mut Canvas, x: usize, y: usize, colour: Rgb) {
        for (index, &cover) in self.cover.iter().enumerate() {
            if cover > 0.0 {
                canvas.blend(x + index % self.width, y + index / self.width, colour, cover);
            }
        }
    }

    fn edge(&mut self, from: Vec3, to: Vec3) {
        let [mut from, mut to] = [from, to].map(|point| self.camera.camera_from_world * point);
        let near_m = self.camera.near_m.max(1e-3);
        if from.z < near_m {
            std::mem::swap(&mut from, &mut to);
        }
        if from.z < near_m {
            return;
        }
        if to.z < near_m {
            to = from + (to - from) * ((from.z - near_m) / (from.z - to.z));
        }
        let [a, b] = [from, to].map(|point| self.camera.project(point, self.width, self.height));
        let length_px = (b.x - a.x).hypot(b.y - a.y);
        // A line that runs far out of the picture is not worth its dots.
        let steps = ((length_px * 2.0) as usize).clamp(1, 8 * (self.width + self.height));
        for step in 0..=steps {
            let t = step as f32 / steps as f32;
            let between = |a: f32, b: f32| a + (b - a) * t;
            let pixel = Pixel { x: between(a.x, b.x), y: between(a.y, b.y), nearness: between(a.nearness, b.nearness) };
            let depth_m = self.camera.unproject(pixel, self.width, self.height).z;
            if self.shown(pixel, depth_m) || self.dash(length_px * t) {
                self.dot(pixel.x, pixel.y);
            }
        }
    }

    fn shown(&self, pixel: Pixel, depth_m: f32) -> bool {
        let inside = |at: f32, end: usize| (0.0..end as f32).contains(&at);
        inside(pixel.x, self.width)
            && inside(pixel.y, self.height)
            && (self.depth_m)(pixel.x as usize, pixel.y as usize) > depth_m - SLACK_M
    }

    fn dash(&self, along_px: f32) -> bool {
        ((along_px / (DASH * self.line_px)) as usize).is_multiple_of(2)
    }

    fn dot(&mut self, x: f32, y: f32) {
        let reach = 0.5 * self.line_px + 0.5;
        let columns = (x - reach).floor().max(0.0) as usize..((x + reach).ceil().max(0.0) as usize).min(self.width);
        for row in (y - reach).floor().max(0.0) as usize..((y + reach).ceil().max(0.0) as usize).min(self.height) {
            for column in columns.clone() {
                let distance_px = (column as f32 + 0.5 - x).hypot(row as f32 + 0.5 - y);
                let cover = (reach - distance_px).clamp(0.0, 1.0);
                let at = &mut self.cover[row * self.width + column];
                *at = at.max(cover);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::camera::Projection;
    use super::*;
    use rapier3d::math::Pose3;

    fn covered(depth_m: f32, draw: impl Fn(&mut Marks<'_, Box<dyn Fn(usize, usize) -> f32>>)) -> usize {
        let camera = Camera::new(Pose3::identity(), Projection::Central { tan_half_width: 1.0 }, 0.05);
        let mut marks = Marks::new(&camera, 200, 200, Box::new(move |_, _| depth_m) as Box<_>);
        draw(&mut marks);
        let mut canvas = Canvas::new(200, 200, [0; 3]);
        marks.lay(&mut canvas, 0, 0, GOAL);
        // Covered by half at least.
        canvas.pixels.iter().filter(|pixel| 2 * u32::from(pixel[1]) > u32::from(GOAL[1])).count()
    }

    #[test]
    fn what_is_hidden_is_dashed_and_what_is_behind_the_camera_is_not_drawn() {
        let cube = |z: f32| move |marks: &mut Marks<'_, _>| marks.cube(Vec3::new(0.0, 0.0, z), 0.5);
        let (seen, hidden) = (covered(9.0, cube(2.0)), covered(1.0, cube(2.0)));
        assert!(seen > 400 && hidden > seen / 4 && hidden < seen * 4 / 5, "{seen} pixels, {hidden} when hidden");
        assert_eq!(covered(9.0, cube(-2.0)), 0);
        let ring = |z: f32| move |marks: &mut Marks<'_, _>| marks.ring(Vec3::new(0.0, 0.0, z), 0.2);
        assert!(covered(9.0, ring(2.0)) > covered(1.0, ring(2.0)) && covered(1.0, ring(2.0)) > 10);
        assert_eq!(covered(9.0, ring(-2.0)), 0);
    }
}
