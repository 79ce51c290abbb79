//! What there is to see, and the walk over it.

use crate::camera::{Camera, Lens, Placed, Pose, Rectangle};
use crate::image::Image;
use crate::mesh::Mesh;
use crate::{solid, triangles};
use std::sync::Arc;

/// What a thing looks like, in metres, about its own origin.
#[derive(Debug, Clone)]
pub enum Shape {
    /// The upper side of a rectangle in z = 0, by its half extents; one of 0 is without an end.
    Plane {
        half_m: [f64; 2],
    },
    Cuboid {
        half_m: [f64; 3],
    },
    /// An ellipsoid, or a ball.
    Ellipsoid {
        radii_m: [f64; 3],
    },
    /// Along z.
    Cylinder {
        radius_m: f64,
        half_height_m: f64,
    },
    /// Along z: a cylinder of this height with a half ball at each end.
    Capsule {
        radius_m: f64,
        half_height_m: f64,
    },
    Mesh(Arc<Mesh>),
}

/// Things that a camera sees, each with the number that it has among the poses of a frame.
#[derive(Debug, Clone, Default)]
pub struct Scene {
    things: Vec<(u32, Shape)>,
}

#[derive(Debug, Clone, Copy)]
struct InView {
    thing: usize,
    nearest_m: f64,
    at: Rectangle,
    placed: Placed,
}

/// Draws scenes; its buffers live from frame to frame.
#[derive(Debug, Clone, Default)]
pub struct Renderer {
    image: Image,
    in_view: Vec<InView>,
}

impl Shape {
    /// The middle and the radius of a ball about it; none about a plane.
    fn ball(&self) -> Option<([f64; 3], f64)> {
        let length = |v: [f64; 3]| crate::camera::dot(v, v).sqrt();
        let radius_m = match self {
            Self::Plane { .. } => return None,
            Self::Cuboid { half_m } => length(*half_m),
            Self::Ellipsoid { radii_m } => radii_m.iter().copied().fold(0.0, f64::max),
            Self::Cylinder { radius_m, half_height_m } => length([*radius_m, *half_height_m, 0.0]),
            Self::Capsule { radius_m, half_height_m } => radius_m + half_height_m,
            Self::Mesh(mesh) => {
                return Some((mesh.ball.centre_m.map(f64::from), f64::from(mesh.ball.radius_m)));
            }
        };
        Some(([0.0; 3], radius_m))
    }
}

impl Scene {
    pub fn add(&mut self, number: u32, shape: Shape) {
        self.things.push((number, shape));
    }
}

impl Renderer {
    pub fn render(&mut self, scene: &Scene, camera: &Camera, world_from_thing: impl Fn(u32) -> Pose) {
        let lens = &camera.lens;
        self.image.begin(lens);
        self.in_view.clear();
        for (thing, (number, shape)) in scene.things.iter().enumerate() {
            let placed = camera.place(&world_from_thing(*number));
            let (at, nearest_m) = match shape.ball() {
                // Planes last: they are large, and mostly behind.
                None => (Some(lens.whole()), f64::INFINITY),
                Some((middle_m, radius_m)) => {
                    let middle_m = placed.point(middle_m);
                    (lens.rectangle(middle_m, radius_m), middle_m[2] - radius_m)
                }
            };
            if let Some(at) = at {
                self.in_view.push(InView { thing, nearest_m, at, placed });
            }
        }
        // From the eye outwards, so that what is near hides what is far before that is drawn.
        self.in_view.sort_by(|a, b| a.nearest_m.total_cmp(&b.nearest_m));
        for InView { thing, nearest_m, at, placed } in &self.in_view {
            if nearest_m.is_finite() && *nearest_m > lens.near_m && self.image.hides(*at, (1.0 / nearest_m) as f32) {
                continue;
            }
            let (number, shape) = &scene.things[*thing];
            draw(&mut self.image, lens, placed, shape, *at, *number);
        }
    }

    /// Depth along the camera's axis in millimetres, rounded, at most [`crate::DEPTH_MAX_MM`]; 0 where nothing is. Row
    /// by row from the top left. Panics if the frame has not the size of the lens, as all of these.
    pub fn millimetres(&self, depth_mm: &mut [u16]) {
        self.image.millimetres(depth_mm);
    }

    pub fn metres(&self, depth_m: &mut [f32]) {
        self.image.metres(depth_m);
    }

    /// The number of the thing at each pixel; -1 where nothing is.
    pub fn numbers(&self, numbers: &mut [i32]) {
        self.image.numbers(numbers);
    }
}

fn draw(image: &mut Image, lens: &Lens, placed: &Placed, shape: &Shape, at: Rectangle, number: u32) {
    match shape {
        Shape::Plane { half_m } => solid::plane(image, lens, placed, *half_m, at, number),
        Shape::Cuboid { half_m } => solid::cuboid(image, lens, placed, *half_m, at, number),
        Shape::Ellipsoid { radii_m } => solid::ellipsoid(image, lens, placed, *radii_m, at, number),
        &Shape::Cylinder { radius_m, half_height_m } => {
            solid::cylinder(image, lens, placed, radius_m, half_height_m, at, number);
        }
        &Shape::Capsule { radius_m, half_height_m } => {
            solid::capsule(image, lens, placed, radius_m, half_height_m, at, number);
        }
        // It notes itself where it has drawn.
        Shape::Mesh(mesh) => return triangles::mesh(image, lens, placed, mesh, number),
    }
    image.touch(at);
}
