//! Projection, near plane, and view volume.
//!
//! Camera frame: x right, y up, z ahead. Image frame: x to the right and y *down*, in pixels, from the centre.

use super::depth_buffer::Corner;
use super::outline::Corners;
use super::surface::Plane;
use depth::simd::Lanes;
pub use proto::camera::TAN_HALF_FIELD_OF_VIEW;

/// cos(50°) and sin(50°): the normals of the view volume's sides.
const SIDE_NORMAL: [f32; 2] = [0.642_787_6, 0.766_044_44];
/// What lies nearer than this along the axis is not drawn, metres.
pub const NEAR_M: f32 = 0.05;

/// Pixels per unit of x / z, and the image's centre.
#[derive(Debug, Clone, Copy)]
pub struct Lens {
    pub side: usize,
    pub focal_px: f32,
    pub centre_px: f32,
}

impl Lens {
    pub fn of(side: usize) -> Self {
        let centre_px = side as f32 * 0.5;
        Self { side, focal_px: centre_px / TAN_HALF_FIELD_OF_VIEW, centre_px }
    }

    /// Where a point of the camera's frame is seen.
    pub fn project(self, p: [f32; 3]) -> Corner {
        let inverse_m = 1.0 / p[2];
        let scale = self.focal_px * inverse_m;
        Corner::new(self.centre_px + p[0] * scale, self.centre_px - p[1] * scale, inverse_m, self.side)
    }

    /// Where eight points of the camera's frame are seen, and their inverse depths.
    #[inline(always)]
    pub fn project_lanes(self, p: [Lanes; 3]) -> (Corners, Lanes) {
        let inverse_m = Lanes::splat(1.0) / p[2];
        let scale = Lanes::splat(self.focal_px) * inverse_m;
        let centre = Lanes::splat(self.centre_px);
        (Corners { x_px: centre + p[0] * scale, y_px: centre - p[1] * scale }, inverse_m)
    }

    /// v · d over the image, where d is the direction of a pixel's ray, with z = 1.
    pub fn over_image(self, v: [f32; 3]) -> Plane {
        let (per_x, per_y) = (v[0] / self.focal_px, -v[1] / self.focal_px);
        Plane { at_origin: v[2] - (per_x + per_y) * self.centre_px, per_x, per_y }
    }

    /// Inverse depth over the image of the plane normal · p = −height, camera's frame: the camera stands `height`
    /// above it.
    pub fn plane(self, normal: [f32; 3], height_m: f32) -> Plane {
        let per_height = -1.0 / height_m;
        self.over_image(normal.map(|v| v * per_height))
    }
}

/// A face is seen from this height above it on, metres.
pub const LEAST_HEIGHT_M: f32 = 1e-6;

/// A rigid transformation: row-major rotation, then translation.
#[derive(Debug, Clone, Copy)]
pub struct Rigid {
    pub rotation: [[f32; 3]; 3],
    pub translation: [f32; 3],
}

impl Rigid {
    pub fn from_pose(pose: &rapier3d::math::Pose3) -> Self {
        let (x, y, z, w) = (pose.rotation.x, pose.rotation.y, pose.rotation.z, pose.rotation.w);
        Self {
            rotation: [
                [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
                [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
                [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
            ],
            translation: [pose.translation.x, pose.translation.y, pose.translation.z],
        }
    }

    /// `self` after `first`.
    pub fn after(&self, first: &Self) -> Self {
        let mut rotation = [[0.0; 3]; 3];
        for (row, out) in self.rotation.iter().zip(&mut rotation) {
            for (column, out) in out.iter_mut().enumerate() {
                *out = row[0] * first.rotation[0][column]
                    + row[1] * first.rotation[1][column]
                    + row[2] * first.rotation[2][column];
            }
        }
        Self { rotation, translation: self.point(first.translation) }
    }

    pub fn inverse(&self) -> Self {
        let r = &self.rotation;
        let rotation = [[r[0][0], r[1][0], r[2][0]], [r[0][1], r[1][1], r[2][1]], [r[0][2], r[1][2], r[2][2]]];
        let turned = Self { rotation, translation: [0.0; 3] }.point(self.translation);
        Self { rotation, translation: turned.map(|v| -v) }
    }

    pub fn point(&self, p: [f32; 3]) -> [f32; 3] {
        let v = self.vector(p);
        [v[0] + self.translation[0], v[1] + self.translation[1], v[2] + self.translation[2]]
    }

    pub fn vector(&self, v: [f32; 3]) -> [f32; 3] {
        self.rotation.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
    }

    /// Where this transformation's target has its origin, seen from its source: `self.inverse().translation`.
    pub fn origin_of_target(&self) -> [f32; 3] {
        let (r, t) = (&self.rotation, &self.translation);
        [0, 1, 2].map(|i| -(r[0][i] * t[0] + r[1][i] * t[1] + r[2][i] * t[2]))
    }
}

/// Where the eye stands in the world, and where it looks.
#[derive(Debug, Clone, Copy)]
pub struct View {
    pub lens: Lens,
    pub camera_from_world: Rigid,
    pub eye: [f32; 3],
    /// The direction of a pixel's ray, z = 1, in the world: at the image's origin, and its change per pixel.
    pub ray: [[f32; 3]; 3],
}

impl View {
    pub fn new(lens: Lens, world_from_camera: &rapier3d::math::Pose3) -> Self {
        let world_from_camera = Rigid::from_pose(world_from_camera);
        let camera_from_world = world_from_camera.inverse();
        let column = |axis: usize| world_from_camera.rotation.map(|row| row[axis]);
        let (right, up, ahead) = (column(0), column(1), column(2));
        let per_focal = 1.0 / lens.focal_px;
        let corner = lens.centre_px * per_focal;
        Self {
            lens,
            camera_from_world,
            eye: world_from_camera.translation,
            ray: [
                [0, 1, 2].map(|i| ahead[i] + corner * (up[i] - right[i])),
                right.map(|v| v * per_focal),
                up.map(|v| -v * per_focal),
            ],
        }
    }

    /// Eight points of the world, seen from the camera.
    #[inline(always)]
    pub fn points(&self, p: [Lanes; 3]) -> [Lanes; 3] {
        let d = [0, 1, 2].map(|i| p[i] - Lanes::splat(self.eye[i]));
        self.camera_from_world.rotation.map(|row| dot(row.map(Lanes::splat), d))
    }
}

#[inline(always)]
pub fn dot(a: [Lanes; 3], b: [Lanes; 3]) -> Lanes {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Which of eight spheres, centres in the camera's frame, meet the view volume.
#[inline(always)]
pub fn meets_view(centre: [Lanes; 3], radius_m: Lanes) -> u32 {
    let [x, y, z] = centre;
    let [across, along] = SIDE_NORMAL.map(Lanes::splat);
    let zero = Lanes::splat(0.0);
    let least_along = z * along + radius_m;
    let within = |v: Lanes| (v.max(zero - v) * across).less(least_along);
    within(x).and(within(y)).and(Lanes::splat(NEAR_M).less(z + radius_m)).bits()
}

/// Cuts a convex polygon, camera frame, at the near plane. `out` is empty if nothing is left.
///
/// A new corner is computed from the corner ahead of the plane to the one behind it, whichever way the polygon runs,
/// so two faces that share an edge get the same corner.
pub fn clip_near(polygon: &[[f32; 3]], out: &mut Vec<[f32; 3]>) {
    out.clear();
    for (i, &a) in polygon.iter().enumerate() {
        let b = polygon[(i + 1) % polygon.len()];
        if a[2] >= NEAR_M {
            out.push(a);
        }
        if (a[2] >= NEAR_M) != (b[2] >= NEAR_M) {
            let (front, back) = if a[2] >= NEAR_M { (a, b) } else { (b, a) };
            let t = (front[2] - NEAR_M) / (front[2] - back[2]);
            out.push([front[0] + t * (back[0] - front[0]), front[1] + t * (back[1] - front[1]), NEAR_M]);
        }
    }
}
