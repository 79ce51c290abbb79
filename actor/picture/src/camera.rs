use rapier3d::math::{Pose3, Vec3};

/// A camera: x right, y up, looks along +z.
#[derive(Debug, Clone, Copy)]
// `camera_from_world` names its frames, as poses do everywhere.
#[allow(clippy::struct_field_names)]
pub struct Camera {
    pub camera_from_world: Pose3,
    pub projection: Projection,
    /// What is nearer than this along the axis is cut away, metres.
    pub near_m: f32,
}

#[derive(Debug, Clone, Copy)]
pub enum Projection {
    /// Along parallel rays; the picture's width is twice this, metres.
    Parallel { half_width_m: f32 },
    /// Through the camera's centre; this is the tangent of half the horizontal field of view.
    Central { tan_half_width: f32 },
}

#[derive(Debug, Clone, Copy)]
pub struct Pixel {
    /// To the right, pixels from the left edge.
    pub x: f32,
    /// Down, pixels from the upper edge.
    pub y: f32,
    /// Grows towards the camera and is affine over the image of a plane: 1 / depth in a central projection, −depth in
    /// a parallel one (1/m or m).
    pub nearness: f32,
}

impl Camera {
    pub fn new(world_from_camera: Pose3, projection: Projection, near_m: f32) -> Self {
        Self { camera_from_world: world_from_camera.inverse(), projection, near_m }
    }

    /// Where a point of the camera's frame, not nearer than `near_m`, falls in a picture of this size.
    pub fn project(&self, p: Vec3, width: usize, height: usize) -> Pixel {
        let (half_x, half_y) = (0.5 * width as f32, 0.5 * height as f32);
        let (scale, nearness) = match self.projection {
            Projection::Parallel { half_width_m } => (half_x / half_width_m, -p.z),
            Projection::Central { tan_half_width } => (half_x / (tan_half_width * p.z), 1.0 / p.z),
        };
        Pixel { x: half_x + scale * p.x, y: half_y - scale * p.y, nearness }
    }

    pub fn unproject(&self, pixel: Pixel, width: usize, height: usize) -> Vec3 {
        let (half_x, half_y) = (0.5 * width as f32, 0.5 * height as f32);
        let (scale, z) = match self.projection {
            Projection::Parallel { half_width_m } => (half_width_m / half_x, -pixel.nearness),
            Projection::Central { tan_half_width } => (tan_half_width / half_x / pixel.nearness, 1.0 / pixel.nearness),
        };
        Vec3::new((pixel.x - half_x) * scale, (half_y - pixel.y) * scale, z)
    }

    pub fn ray(&self, point: Vec3) -> Vec3 {
        match self.projection {
            Projection::Parallel { .. } => Vec3::Z,
            Projection::Central { .. } => point.normalize(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use simulator::physics::geometry::rotation_x;

    #[test]
    fn a_projected_point_is_found_again() {
        let pose = Pose3::from_parts(Vec3::new(1.0, 2.0, -3.0), rotation_x(0.4));
        for projection in [Projection::Parallel { half_width_m: 2.0 }, Projection::Central { tan_half_width: 1.2 }] {
            let camera = Camera::new(pose, projection, 0.1);
            let point = camera.camera_from_world * Vec3::new(1.3, 1.5, -1.0);
            let again = camera.unproject(camera.project(point, 300, 200), 300, 200);
            assert!((again - point).length() < 1e-4, "{point} came back as {again}");
        }
    }
}
