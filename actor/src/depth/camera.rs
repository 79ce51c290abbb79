//! The walk over bodies: culling, choice of detail, projection.

use super::mesh::{Mesh, Solid};
use super::raster::{Corner, Plane, Raster};
use super::view::{NEAR_M, Rigid, Sphere, TAN_HALF_FIELD_OF_VIEW, Visibility, clip_near, visibility};
use crate::kitchen::Body;
use crate::shape::Primitive;
use rapier3d::math::Pose3;
use std::mem::MaybeUninit;

/// A level of detail will do if it deviates by at most this much in the image, pixels.
const DETAIL_ERROR_PX: f32 = 0.35;

/// Renders the depth images of one kitchen. Geometry is shared by all environments that it renders; poses come with
/// each call.
#[derive(Debug, Clone)]
pub struct DepthCamera {
    solids: Vec<Solid>,
    bodies: Vec<BodyView>,
    raster: Raster,
    scratch: Scratch,
    triangles_in_view: usize,
    view_set_triangles: usize,
}

#[derive(Debug, Clone)]
struct BodyView {
    parts: Vec<PartView>,
    /// At the finest level of detail.
    triangles: usize,
    /// Around all parts, body's frame.
    bounds: Sphere,
}

#[derive(Debug, Clone)]
struct PartView {
    solid: usize,
    body_from_part: Rigid,
}

/// Buffers that live from call to call.
#[derive(Debug, Clone, Default)]
struct Scratch {
    /// Height of the eye above each face of the part at hand, metres.
    heights_m: Vec<f32>,
    /// Vertices of the part at hand, in the image.
    projected: Vec<Corner>,
    /// The face at hand, in the image.
    corners: Vec<Corner>,
    /// The face at hand, camera's frame, before and after clipping.
    polygon: Vec<[f32; 3]>,
    clipped: Vec<[f32; 3]>,
}

/// Pixels per unit of x/z, and the image's centre.
#[derive(Debug, Clone, Copy)]
struct Lens {
    side: usize,
    focal_px: f32,
    centre_px: f32,
}

impl Lens {
    fn of(side: usize) -> Self {
        let centre_px = side as f32 * 0.5;
        Self { side, focal_px: centre_px / TAN_HALF_FIELD_OF_VIEW, centre_px }
    }

    fn project(self, p: [f32; 3]) -> Corner {
        let inverse_m = 1.0 / p[2];
        let scale = self.focal_px * inverse_m;
        Corner::new(self.centre_px + p[0] * scale, self.centre_px - p[1] * scale, inverse_m, self.side)
    }

    /// Inverse depth over the image of the plane normal · p = −height, camera's frame: the camera stands `height`
    /// above it.
    fn plane(self, normal: [f32; 3], height_m: f32) -> Plane {
        let per_height = 1.0 / height_m;
        let per_pixel = per_height / self.focal_px;
        let (per_x, per_y) = (-normal[0] * per_pixel, normal[1] * per_pixel);
        let at_centre = -normal[2] * per_height;
        Plane { at_origin: at_centre - (per_x + per_y) * self.centre_px, per_x, per_y }
    }
}

impl DepthCamera {
    /// A camera for these bodies.
    pub fn new(bodies: &[Body]) -> Self {
        let mut primitives: Vec<&Primitive> = Vec::new();
        let mut solids: Vec<Solid> = Vec::new();
        let bodies = bodies
            .iter()
            .map(|body| {
                let parts: Vec<PartView> = body
                    .shape
                    .parts
                    .iter()
                    .map(|part| {
                        let known = primitives.iter().position(|&known| *known == part.primitive);
                        let solid = known.unwrap_or_else(|| {
                            primitives.push(&part.primitive);
                            solids.push(Solid::of(&part.primitive));
                            solids.len() - 1
                        });
                        PartView { solid, body_from_part: Rigid::from_pose(&part.body_from_part) }
                    })
                    .collect();
                let bounds = around(&parts, &solids);
                let finest = |part: &PartView| solids[part.solid].levels.last().map_or(0, |(_, mesh)| mesh.triangles());
                let triangles = parts.iter().map(finest).sum();
                BodyView { parts, triangles, bounds }
            })
            .collect();
        Self {
            solids,
            bodies,
            raster: Raster::new(proto::message::FRAME_SIDE),
            scratch: Scratch::default(),
            triangles_in_view: 0,
            view_set_triangles: 0,
        }
    }

    /// Triangles of all bodies at their finest level of detail.
    pub fn triangles(&self) -> usize {
        self.bodies.iter().map(|body| body.triangles).sum()
    }

    /// Triangles of the view set of the last image: all bodies that met the view volume, whole, at their finest level
    /// of detail ([`super::triangles_of`]).
    pub fn view_set_triangles(&self) -> usize {
        self.view_set_triangles
    }

    /// Triangles of the last image after culling and choice of detail, both sides of each solid.
    pub fn triangles_in_view(&self) -> usize {
        self.triangles_in_view
    }

    /// Renders into `depth_mm`: `side` × `side` pixels, row-major from the top left.
    ///
    /// # Panics
    /// If there is not one pose a body, or the frame has another size.
    pub fn render(&mut self, world_from_bodies: &[Pose3], world_from_camera: Pose3, side: usize, depth_mm: &mut [u16]) {
        let frame = super::simd::as_unwritten(depth_mm);
        self.render_into(world_from_bodies, world_from_camera, side, frame);
    }

    /// Renders into memory that need not be initialised, and returns it initialised.
    ///
    /// # Panics
    /// If there is not one pose a body, or the frame has another size.
    pub fn render_into<'a>(
        &mut self,
        world_from_bodies: &[Pose3],
        world_from_camera: Pose3,
        side: usize,
        depth_mm: &'a mut [MaybeUninit<u16>],
    ) -> &'a [u16] {
        assert_eq!(world_from_bodies.len(), self.bodies.len(), "one pose a body");
        if self.raster.side() != side {
            self.raster = Raster::new(side);
        }
        self.triangles_in_view = 0;
        self.view_set_triangles = 0;
        let lens = Lens::of(side);
        let camera_from_world = Rigid::from_pose(&world_from_camera).inverse();
        for (body, world_from_body) in self.bodies.iter().zip(world_from_bodies) {
            let camera_from_body = camera_from_world.after(&Rigid::from_pose(world_from_body));
            let bounds = body.bounds;
            if visibility(camera_from_body.point(bounds.centre), bounds.radius_m) == Visibility::None {
                continue;
            }
            self.view_set_triangles += body.triangles;
            for part in &body.parts {
                let solid = &self.solids[part.solid];
                let camera_from_part = camera_from_body.after(&part.body_from_part);
                let centre = camera_from_part.point(solid.bounds.centre);
                let near_cut = match visibility(centre, solid.bounds.radius_m) {
                    Visibility::None => continue,
                    Visibility::NearCut => true,
                    Visibility::Whole => false,
                };
                let nearest_m = (centre[2] - solid.bounds.radius_m).max(NEAR_M);
                let tolerance_m = DETAIL_ERROR_PX * nearest_m / lens.focal_px;
                let finest = solid.levels.len() - 1;
                let level = solid.levels.iter().position(|&(error_m, _)| error_m <= tolerance_m).unwrap_or(finest);
                let mesh = &solid.levels[level].1;
                self.triangles_in_view += mesh.triangles();
                draw(&mut self.raster, &mut self.scratch, lens, mesh, &camera_from_part, near_cut);
            }
        }
        self.raster.finish(depth_mm)
    }
}

/// Draws one convex mesh.
fn draw(raster: &mut Raster, scratch: &mut Scratch, lens: Lens, mesh: &Mesh, camera_from_part: &Rigid, near_cut: bool) {
    let eye = camera_from_part.origin_of_target();
    // All at once, for the vector unit: most faces go no further.
    scratch.heights_m.clear();
    scratch.heights_m.extend(mesh.faces.iter().map(|face| {
        let n = face.normal;
        n[0] * eye[0] + n[1] * eye[1] + n[2] * eye[2] - face.offset_m
    }));
    scratch.projected.clear();
    if !near_cut {
        scratch.projected.extend(mesh.vertices.iter().map(|&v| lens.project(camera_from_part.point(v))));
    }
    for (face, &height_m) in mesh.faces.iter().zip(&scratch.heights_m) {
        // The eye is behind it: the face looks away.
        if height_m <= 0.0 {
            continue;
        }
        let plane = lens.plane(camera_from_part.vector(face.normal), height_m);
        let corners = &mesh.corners[face.first as usize..(face.first + face.count) as usize];
        scratch.corners.clear();
        if near_cut {
            scratch.polygon.clear();
            scratch.polygon.extend(corners.iter().map(|&i| camera_from_part.point(mesh.vertices[usize::from(i)])));
            clip_near(&scratch.polygon, &mut scratch.clipped);
            if scratch.clipped.len() < 3 {
                continue;
            }
            scratch.corners.extend(scratch.clipped.iter().map(|&p| lens.project(p)));
        } else {
            scratch.corners.extend(corners.iter().map(|&i| scratch.projected[usize::from(i)]));
        }
        raster.fill(&scratch.corners, plane);
    }
}

/// A sphere around parts, body's frame.
fn around(parts: &[PartView], solids: &[Solid]) -> Sphere {
    let spheres: Vec<Sphere> = parts
        .iter()
        .map(|part| {
            let bounds = solids[part.solid].bounds;
            Sphere { centre: part.body_from_part.point(bounds.centre), ..bounds }
        })
        .collect();
    let (mut low, mut high) = ([f32::MAX; 3], [f32::MIN; 3]);
    for sphere in &spheres {
        for axis in 0..3 {
            low[axis] = low[axis].min(sphere.centre[axis] - sphere.radius_m);
            high[axis] = high[axis].max(sphere.centre[axis] + sphere.radius_m);
        }
    }
    if spheres.is_empty() {
        return Sphere { centre: [0.0; 3], radius_m: 0.0 };
    }
    let centre = [0, 1, 2].map(|axis| 0.5 * (low[axis] + high[axis]));
    let reach = |sphere: &Sphere| {
        let d = [0, 1, 2].map(|axis| sphere.centre[axis] - centre[axis]);
        (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt() + sphere.radius_m
    };
    Sphere { centre, radius_m: spheres.iter().map(reach).fold(0.0, f32::max) * 1.0001 }
}
