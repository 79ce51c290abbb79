//! The walk over what is in view.

use super::backdrop::{Backdrop, Redraw, roles};
use super::mesh::Mesh;
use super::outline::{Corners, Outline};
use super::raster::{Corner, Extent, Raster};
use super::round::{LEAST_HEIGHT_M, Round, RoundBrush, rows_of};
use super::scene::{Form, PartView, Scene};
use super::simd::{LANES, Lanes, Mask, as_unwritten};
use super::surface::{ManyPlanes, Plane, Planes};
use super::view::{Lens, NEAR_M, Rigid, TAN_HALF_FIELD_OF_VIEW, clip_near, visible};
use crate::kitchen::{Body, BodyRole};
use rapier3d::math::Pose3;
use std::mem::MaybeUninit;

/// Renders the depth images of one kitchen. Geometry is shared by all environments that it renders; poses come with
/// each call.
#[derive(Debug, Clone)]
pub struct DepthCamera {
    scene: Scene,
    roles: Vec<BodyRole>,
    cuboids: CuboidOutlines,
    raster: Raster,
    outline: Outline,
    brush: RoundBrush,
    scratch: Scratch,
    view_set_triangles: usize,
}

/// Buffers that live from call to call.
#[derive(Debug, Clone, Default)]
struct Scratch {
    /// Parts that meet the view volume, and their bounds' centres in the camera's frame.
    visible: Vec<(u32, [f32; 3])>,
    /// Vertices of the part at hand, in the image.
    x_px: Vec<f32>,
    y_px: Vec<f32>,
    inverse_m: Vec<f32>,
    /// Which faces of the part at hand look at the eye.
    front: Vec<bool>,
    planes: ManyPlanes,
    front_faces: Vec<u16>,
    /// The face at hand, in the image.
    corners: Vec<Corner>,
    /// The face at hand, camera's frame, before and after clipping.
    polygon: Vec<[f32; 3]>,
    clipped: Vec<[f32; 3]>,
}

/// Where the eye stands in the world, and where it looks.
#[derive(Debug, Clone, Copy)]
struct View {
    lens: Lens,
    camera_from_world: Rigid,
    eye: [f32; 3],
    /// The direction of a pixel's ray, z = 1, in the world: at the image's origin, and its change per pixel.
    ray: [[f32; 3]; 3],
}

impl View {
    fn new(lens: Lens, world_from_camera: &Pose3) -> Self {
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
    fn points(&self, p: [Lanes; 3]) -> [Lanes; 3] {
        let d = [0, 1, 2].map(|i| p[i] - Lanes::splat(self.eye[i]));
        self.camera_from_world.rotation.map(|row| dot(row.map(Lanes::splat), d))
    }
}

#[inline(always)]
fn dot(a: [Lanes; 3], b: [Lanes; 3]) -> Lanes {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

impl DepthCamera {
    /// A camera for these bodies.
    pub fn new(bodies: &[Body]) -> Self {
        Self {
            scene: Scene::new(bodies),
            roles: roles(bodies),
            cuboids: CuboidOutlines::new(),
            raster: Raster::new(proto::message::FRAME_SIDE),
            outline: Outline::default(),
            brush: RoundBrush::new(),
            scratch: Scratch::default(),
            view_set_triangles: 0,
        }
    }

    /// Triangles of all bodies at their finest ([`super::triangles_of`]).
    pub fn triangles(&self) -> usize {
        (0..self.scene.body_count()).map(|body| self.scene.triangles(body)).sum()
    }

    /// Triangles of the view set of the last image: all bodies of which a part met the view volume, whole, at their
    /// finest ([`super::triangles_of`]).
    pub fn view_set_triangles(&self) -> usize {
        self.view_set_triangles
    }

    /// Renders into `depth_mm`: `side` × `side` pixels, row-major from the top left.
    ///
    /// # Panics
    /// If there is not one pose a body, or the frame has another size.
    pub fn render(&mut self, world_from_bodies: &[Pose3], world_from_camera: Pose3, side: usize, depth_mm: &mut [u16]) {
        let frame = as_unwritten(depth_mm);
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
        let view = self.set_up(world_from_bodies, &world_from_camera, side);
        self.view_set_triangles = self.draw(&view, |_| true);
        self.raster.finish(depth_mm)
    }

    /// Renders the same frame as [`Self::render_into`], bit for bit, and remembers in `backdrop` what is likely to be
    /// the same in the next one. One backdrop belongs to one environment; what it remembers is checked, so that a
    /// wrong one costs time and nothing else.
    ///
    /// # Panics
    /// If there is not one pose a body, or the frame has another size.
    pub fn render_over<'a>(
        &mut self,
        backdrop: &mut Backdrop,
        world_from_bodies: &[Pose3],
        world_from_camera: Pose3,
        side: usize,
        depth_mm: &'a mut [MaybeUninit<u16>],
    ) -> &'a [u16] {
        let view = self.set_up(world_from_bodies, &world_from_camera, side);
        if backdrop.prepare(&self.roles, world_from_bodies, &world_from_camera, side) == Redraw::Everything {
            backdrop.view_set_triangles = self.draw(&view, |body| backdrop.holds(body));
            self.raster.finish(as_unwritten(&mut backdrop.frame_mm));
        }
        let before = self.draw(&view, |body| !backdrop.holds(body));
        self.view_set_triangles = backdrop.view_set_triangles + before;
        self.raster.finish_over(&backdrop.frame_mm, depth_mm)
    }

    fn set_up(&mut self, world_from_bodies: &[Pose3], world_from_camera: &Pose3, side: usize) -> View {
        if self.raster.side() != side {
            self.raster = Raster::new(side);
        }
        self.scene.place(world_from_bodies);
        View::new(Lens::of(side), world_from_camera)
    }

    /// Draws those bodies in view that are `wanted`; returns how many triangles they have at their finest.
    fn draw(&mut self, view: &View, wanted: impl Fn(usize) -> bool) -> usize {
        let mut triangles = 0;
        self.find_visible(view);
        let visible = std::mem::take(&mut self.scratch.visible);
        let mut last_body = u32::MAX;
        for &(index, centre) in &visible {
            let part = &self.scene.parts[index as usize];
            if !wanted(part.body as usize) {
                continue;
            }
            if part.body != last_body {
                last_body = part.body;
                triangles += self.scene.triangles(part.body as usize);
            }
            let model = &self.scene.models[part.model as usize];
            let cut = centre[2] - model.bounds.radius_m <= NEAR_M;
            match model.form {
                Form::Cuboid | Form::Polyhedron => self.polyhedron(view, index as usize),
                _ if cut => {
                    let camera_from_part = view.camera_from_world.after(&part.world_from_part);
                    clipped(&mut self.raster, &mut self.scratch, view.lens, &model.mesh, &camera_from_part);
                }
                Form::Sphere(round) => RoundBrush::sphere(&mut self.raster, view.lens, centre, round),
                Form::Cylinder(round) => {
                    let axis = axis(view, part);
                    self.brush.cylinder(&mut self.raster, &mut self.outline, view.lens, centre, axis, round);
                }
                Form::Capsule { mantle, ends } => {
                    let axis = axis(view, part);
                    self.capsule(view, centre, axis, mantle, ends);
                }
            }
        }
        self.scratch.visible = visible;
        triangles
    }

    /// Lists the parts whose bounds meet the view volume.
    fn find_visible(&mut self, view: &View) {
        let visible = &mut self.scratch.visible;
        visible.clear();
        for (block, spheres) in self.scene.bounds.iter().enumerate() {
            let centre = view.points(spheres.centre.load());
            let mut bits = visible_bits(centre, spheres.radius_m);
            if bits != 0 {
                let [x, y, z] = centre.map(Lanes::to_array);
                while bits != 0 {
                    let lane = bits.trailing_zeros() as usize;
                    visible.push(((block * LANES + lane) as u32, [x[lane], y[lane], z[lane]]));
                    bits &= bits - 1;
                }
            }
        }
    }

    fn capsule(&mut self, view: &View, centre: [f32; 3], axis: [f32; 3], mantle: Round, ends: Round) {
        for along_m in [mantle.half_height_m, -mantle.half_height_m] {
            let end = [0, 1, 2].map(|i| centre[i] + along_m * axis[i]);
            RoundBrush::sphere(&mut self.raster, view.lens, end, ends);
        }
        self.brush.cylinder(&mut self.raster, &mut self.outline, view.lens, centre, axis, mantle);
    }

    /// Draws a part from its mesh.
    fn polyhedron(&mut self, view: &View, index: usize) {
        let Self { scene, raster, outline, scratch, cuboids, .. } = self;
        let part = &scene.parts[index];
        let model = &scene.models[part.model as usize];
        let side = raster.side() as f32;

        // Its vertices in the image.
        let blocks = &scene.vertices[part.vertices.clone()];
        scratch.x_px.resize(blocks.len() * LANES, 0.0);
        scratch.y_px.resize(blocks.len() * LANES, 0.0);
        scratch.inverse_m.resize(blocks.len() * LANES, 0.0);
        let (mut farthest, mut nearest) = (Lanes::splat(f32::MAX), Lanes::splat(0.0));
        let (mut low, mut high) = ([Lanes::splat(f32::MAX); 2], [Lanes::splat(f32::MIN); 2]);
        let (mut cut, mut outside) = (0, [u32::MAX; 5]);
        let edge = Lanes::splat(TAN_HALF_FIELD_OF_VIEW);
        let mut corners = Corners { x_px: low[0], y_px: low[1] };
        for (block, points) in blocks.iter().enumerate() {
            let p = view.points(points.load());
            let behind = p[2].less(Lanes::splat(NEAR_M)).bits();
            cut |= behind;
            let reach = p[2] * edge;
            let back = Lanes::splat(0.0) - reach;
            let beyond = [p[0].less(back), reach.less(p[0]), p[1].less(back), reach.less(p[1])].map(Mask::bits);
            outside[4] &= behind;
            outside[..4].iter_mut().zip(beyond).for_each(|(outside, beyond)| *outside &= beyond);
            let (projected, inverse_m) = view.lens.project_lanes(p);
            corners = projected;
            farthest = farthest.min(inverse_m);
            nearest = nearest.max(inverse_m);
            low = [low[0].min(corners.x_px), low[1].min(corners.y_px)];
            high = [high[0].max(corners.x_px), high[1].max(corners.y_px)];
            let at = block * LANES..(block + 1) * LANES;
            scratch.x_px[at.clone()].copy_from_slice(&corners.x_px.to_array());
            scratch.y_px[at.clone()].copy_from_slice(&corners.y_px.to_array());
            scratch.inverse_m[at].copy_from_slice(&inverse_m.to_array());
        }
        // All of its vertices lie outside of one side of the view volume.
        if outside.iter().any(|&bits| bits == 255) {
            return;
        }
        if cut != 0 {
            let camera_from_part = view.camera_from_world.after(&part.world_from_part);
            clipped(raster, scratch, view.lens, &model.mesh, &camera_from_part);
            return;
        }
        let Some((top, bottom)) = rows_of(low, high, side) else { return };
        let extent = Extent { top, bottom, inverse_m: [farthest.smallest(), nearest.largest()] };

        // The planes of the faces that look at the eye.
        scratch.planes.clear();
        scratch.front_faces.clear();
        scratch.front.clear();
        let mut first_bits = 0;
        for (block, half_spaces) in scene.half_spaces[part.half_spaces.clone()].iter().enumerate() {
            let normal = half_spaces.normal.load();
            let height_m = dot(normal, view.eye.map(Lanes::splat)) - Lanes::load(&half_spaces.offset_m);
            let bits = Lanes::splat(LEAST_HEIGHT_M).less(height_m).bits();
            scratch.front.extend((0..LANES).map(|lane| bits >> lane & 1 != 0));
            first_bits = if block == 0 { bits } else { first_bits };
            let per_height = Lanes::splat(-1.0) / height_m;
            let [at_origin, per_x, per_y] =
                view.ray.map(|ray| (dot(normal, ray.map(Lanes::splat)) * per_height).to_array());
            let mut bits = bits;
            while bits != 0 {
                let lane = bits.trailing_zeros() as usize;
                scratch.planes.push(Plane { at_origin: at_origin[lane], per_x: per_x[lane], per_y: per_y[lane] });
                scratch.front_faces.push((block * LANES + lane) as u16);
                bits &= bits - 1;
            }
        }
        let count = scratch.planes.len();
        if count == 0 {
            return;
        }
        let columns = high[0].largest().min(side) - low[0].smallest().max(0.0);
        let groups = (bottom - top) as f32 * (columns / LANES as f32 + 1.0);
        outline.clear();
        match (&model.form, &model.edges) {
            (Form::Cuboid, _) => {
                let Some([from, to]) = cuboids.get(first_bits) else { return };
                let pick =
                    |which: &[i32; LANES]| Corners { x_px: corners.x_px.pick(which), y_px: corners.y_px.pick(which) };
                outline.add(pick(from), pick(to), side);
            }
            (_, Some(edges)) if groups < 6.0 * FACE_GROUPS + FACE_GROUPS * count as f32 || true => {
                let mut ends = [[[0.0; LANES]; 2]; 2];
                let mut filled = 0;
                for edge in edges {
                    let [first, second] = edge.faces.map(|face| scratch.front[usize::from(face)]);
                    if first == second {
                        continue;
                    }
                    let [a, b] = edge.ends.map(usize::from);
                    let [from, to] = if first { [a, b] } else { [b, a] };
                    for (end, vertex) in ends.iter_mut().zip([from, to]) {
                        end[0][filled] = scratch.x_px[vertex];
                        end[1][filled] = scratch.y_px[vertex];
                    }
                    filled += 1;
                    if filled == LANES {
                        add_sides(outline, &ends, side);
                        filled = 0;
                    }
                }
                if filled > 0 {
                    // Sides without length are none.
                    for end in &mut ends {
                        end[0][filled..].fill(0.0);
                        end[1][filled..].fill(0.0);
                    }
                    add_sides(outline, &ends, side);
                }
            }
            _ => {
                // Face by face.
                for (number, &face) in scratch.front_faces.iter().enumerate() {
                    let face = model.mesh.faces[usize::from(face)];
                    scratch.corners.clear();
                    scratch.corners.extend(
                        model.mesh.corners[face.first as usize..(face.first + face.count) as usize].iter().map(|&i| {
                            let i = usize::from(i);
                            Corner::new(scratch.x_px[i], scratch.y_px[i], scratch.inverse_m[i], raster.side())
                        }),
                    );
                    raster.fill(&scratch.corners, scratch.planes.get(number));
                }
                return;
            }
        }
        outline.mark(raster, top, bottom);
        let planes = &mut scratch.planes;
        match count {
            1 => raster.sweep(extent, &mut Planes::<1>::new(planes.first())),
            2 => raster.sweep(extent, &mut Planes::<2>::new(planes.first())),
            3 => raster.sweep(extent, &mut Planes::<3>::new(planes.first())),
            _ => raster.sweep(extent, planes),
        }
    }
}

/// Where the y axis of a part points, camera's frame.
fn axis(view: &View, part: &PartView) -> [f32; 3] {
    view.camera_from_world.vector(part.world_from_part.rotation.map(|row| row[1]))
}

const FACE_GROUPS: f32 = 40.0;

fn add_sides(outline: &mut Outline, ends: &[[[f32; LANES]; 2]; 2], side: f32) {
    let corners = |[x_px, y_px]: &[[f32; LANES]; 2]| Corners { x_px: Lanes::load(x_px), y_px: Lanes::load(y_px) };
    outline.add(corners(&ends[0]), corners(&ends[1]), side);
}

/// Draws a convex mesh face by face, cut at the near plane.
fn clipped(raster: &mut Raster, scratch: &mut Scratch, lens: Lens, mesh: &Mesh, camera_from_part: &Rigid) {
    let eye = camera_from_part.origin_of_target();
    for face in &mesh.faces {
        let n = face.normal;
        let height_m = n[0] * eye[0] + n[1] * eye[1] + n[2] * eye[2] - face.offset_m;
        // The eye is behind it: the face looks away.
        if height_m <= LEAST_HEIGHT_M {
            continue;
        }
        let plane = lens.plane(camera_from_part.vector(face.normal), height_m);
        let corners = &mesh.corners[face.first as usize..(face.first + face.count) as usize];
        scratch.polygon.clear();
        scratch.polygon.extend(corners.iter().map(|&i| camera_from_part.point(mesh.vertices[usize::from(i)])));
        clip_near(&scratch.polygon, &mut scratch.clipped);
        if scratch.clipped.len() < 3 {
            continue;
        }
        scratch.corners.clear();
        scratch.corners.extend(scratch.clipped.iter().map(|&p| lens.project(p)));
        raster.fill(&scratch.corners, plane);
    }
}

/// The outline of a box for each set of its faces that look at the eye: where each side begins and ends, clockwise on
/// the screen. Sides that are left over have no length.
#[derive(Debug, Clone)]
struct CuboidOutlines(Vec<Option<[[i32; LANES]; 2]>>);

impl CuboidOutlines {
    fn new() -> Self {
        let mesh = Mesh::of(&crate::shape::Primitive::Cuboid { half_extents_m: rapier3d::math::Vec3::ONE });
        let edges = mesh.edges().expect("a box is closed");
        let outlines = (0..64u32)
            .map(|front| {
                let (mut from, mut to) = ([0; LANES], [0; LANES]);
                let mut count = 0;
                for edge in &edges {
                    let [first, second] = edge.faces.map(|face| front >> face & 1 != 0);
                    if first == second {
                        continue;
                    }
                    if count == LANES {
                        return None;
                    }
                    let [a, b] = edge.ends.map(i32::from);
                    [from[count], to[count]] = if first { [a, b] } else { [b, a] };
                    count += 1;
                }
                Some([from, to])
            })
            .collect();
        Self(outlines)
    }

    fn get(&self, front: u32) -> Option<&[[i32; LANES]; 2]> {
        self.0[front as usize & 63].as_ref()
    }
}

/// Which of eight spheres, centres in the camera's frame, meet the view volume.
#[inline(always)]
fn visible_bits(centre: [Lanes; 3], radius_m: [f32; LANES]) -> u32 {
    visible(centre, Lanes::load(&radius_m))
}
