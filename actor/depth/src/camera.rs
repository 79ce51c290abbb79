//! Where the picture is taken from: a pose, and the lens that maps directions to pixels.

use crate::affine::Affine;

/// A rotation, as the rows of its matrix, and a translation, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    pub rotation: [[f64; 3]; 3],
    pub position_m: [f64; 3],
}

/// What maps directions to pixels, and what lies too near or too far to be seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lens {
    pub width: usize,
    pub height: usize,
    /// Pixels per unit of slope, along rows and columns.
    pub focal_px: [f64; 2],
    /// Where the axis meets the image, pixels from the top left.
    pub centre_px: [f64; 2],
    /// Depths between which things are seen, metres.
    pub near_m: f64,
    pub far_m: f64,
}

/// A camera looks along its -z axis, x to the right and y up, as in `OpenGL` and `MuJoCo`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    pub world_from_camera: Pose,
    pub lens: Lens,
}

/// Pixels, from the first to before the last of columns and rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rectangle {
    pub left: usize,
    pub right: usize,
    pub top: usize,
    pub bottom: usize,
}

/// A thing in the camera's own frame, whose axes run to the right, down and ahead.
#[derive(Debug, Clone, Copy)]
pub struct Placed {
    /// Rows of the rotation from the thing's frame.
    pub rotation: [[f64; 3]; 3],
    pub position_m: [f64; 3],
}

impl Camera {
    /// A thing's pose, seen from here.
    pub fn place(&self, world_from_thing: &Pose) -> Placed {
        let camera = &self.world_from_camera;
        let between = [0, 1, 2].map(|i| world_from_thing.position_m[i] - camera.position_m[i]);
        // Column k of the camera's rotation is its axis k in the world; down and ahead are against y and z.
        let axis = |k: usize, sign: f64| [0, 1, 2].map(|i| sign * camera.rotation[i][k]);
        let axes = [axis(0, 1.0), axis(1, -1.0), axis(2, -1.0)];
        let rotation =
            axes.map(|axis| [0, 1, 2].map(|j| dot(axis, [0, 1, 2].map(|i| world_from_thing.rotation[i][j]))));
        Placed { rotation, position_m: axes.map(|axis| dot(axis, between)) }
    }
}

impl Placed {
    /// The eye in the thing's frame.
    pub fn eye_m(&self) -> [f64; 3] {
        [0, 1, 2].map(|j| -dot(self.column(j), self.position_m))
    }

    /// The thing's axis in the camera's frame.
    pub fn column(&self, j: usize) -> [f64; 3] {
        [0, 1, 2].map(|i| self.rotation[i][j])
    }

    /// A point of the thing in the camera's frame.
    pub fn point(&self, point_m: [f64; 3]) -> [f64; 3] {
        [0, 1, 2].map(|i| dot(self.rotation[i], point_m) + self.position_m[i])
    }
}

impl Lens {
    /// The product of a vector with the ray through each pixel, which has length 1 along the camera's axis.
    pub(crate) fn along_rays(&self, [x, y, z]: [f64; 3]) -> Affine {
        let [per_x, per_y] = [x / self.focal_px[0], y / self.focal_px[1]];
        Affine { at_origin: z - per_x * self.centre_px[0] - per_y * self.centre_px[1], per_x, per_y }
    }

    /// The pixels that can show something of a ball, if any can.
    pub(crate) fn rectangle(&self, [x, y, z]: [f64; 3], radius_m: f64) -> Option<Rectangle> {
        if z + radius_m <= self.near_m || z - radius_m >= self.far_m {
            return None;
        }
        let [(left, right), (top, bottom)] = [(x, 0, self.width), (y, 1, self.height)].map(|(across, axis, size)| {
            if z - radius_m <= self.near_m {
                return (0, size);
            }
            // Slopes of the planes through the eye that touch the ball.
            let square = z * z - radius_m * radius_m;
            let reach = radius_m * (across * across + square).sqrt();
            let edge = |side: f64| {
                let position_px = self.centre_px[axis] + self.focal_px[axis] * (across * z + side * reach) / square;
                (position_px - 0.5).ceil().clamp(0.0, size as f64) as usize
            };
            (edge(-1.0), edge(1.0))
        });
        (left < right && top < bottom).then_some(Rectangle { left, right, top, bottom })
    }

    pub(crate) fn whole(&self) -> Rectangle {
        Rectangle { left: 0, right: self.width, top: 0, bottom: self.height }
    }
}

pub(crate) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
