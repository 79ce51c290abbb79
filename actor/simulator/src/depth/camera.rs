//! The walk over what is in view.

use super::backdrop::{Backdrop, Redraw, roles};
use super::depth_buffer::DepthBuffer;
use super::model::Form;
use super::outline::Outline;
use super::placed_bodies::PlacedBodies;
use super::polyhedron::{Placed, PolyhedronBrush};
use super::round::{RoundBrush, sphere};
use super::view::{Lens, NEAR_M, View, meets_view};
use crate::kitchen::{Body, BodyRole};
use depth::simd::{LANES, Lanes};
use proto::camera::{FRAME_SIDE, SUMS_PIXELS, sum_windows};
use rapier3d::math::Pose3;

#[derive(Debug, Clone)]
pub struct Scenery {
    placed: PlacedBodies,
    roles: Vec<BodyRole>,
}

impl Scenery {
    pub fn of(bodies: &[Body]) -> Self {
        Self { placed: PlacedBodies::new(bodies), roles: roles(bodies) }
    }
}

/// Renders the depth images of one kitchen. Geometry is shared by all environments that it renders; poses come with
/// each call.
#[derive(Debug, Clone)]
pub struct DepthCamera {
    scenery: Scenery,
    buffer: DepthBuffer,
    outline: Outline,
    polyhedra: PolyhedronBrush,
    rounds: RoundBrush,
    /// Parts that meet the view volume, and their bounds' centres in the camera's frame.
    in_view: Vec<(u32, [f32; 3])>,
    view_set_triangles: usize,
}

impl DepthCamera {
    pub fn new(bodies: &[Body]) -> Self {
        Self {
            scenery: Scenery::of(bodies),
            buffer: DepthBuffer::new(FRAME_SIDE),
            outline: Outline::default(),
            polyhedra: PolyhedronBrush::default(),
            rounds: RoundBrush::new(),
            in_view: Vec::new(),
            view_set_triangles: 0,
        }
    }

    /// Takes another scenery in, and gives the one it had. Who has many kitchens turns one camera from one to the next:
    /// then all share the image in the making.
    pub fn exchange(&mut self, scenery: &mut Scenery) {
        std::mem::swap(&mut self.scenery, scenery);
    }

    /// Triangles of all bodies at their finest ([`crate::mesh::triangles_of`]).
    pub fn triangles(&self) -> usize {
        (0..self.scenery.placed.body_count()).map(|body| self.scenery.placed.triangles(body)).sum()
    }

    /// Triangles of the view set of the last image: all bodies of which a part met the view volume, whole, at their
    /// finest ([`crate::mesh::triangles_of`]).
    pub fn view_set_triangles(&self) -> usize {
        self.view_set_triangles
    }

    /// Renders into `depth_mm`: `side` × `side` pixels, row-major from the top left. Panics if there is not one pose a
    /// body, or the frame has another size.
    pub fn render(&mut self, world_from_bodies: &[Pose3], world_from_camera: Pose3, side: usize, depth_mm: &mut [u16]) {
        let view = self.set_up(world_from_bodies, &world_from_camera, side);
        self.view_set_triangles = self.draw(&view, |_| true);
        self.buffer.finish(depth_mm);
    }

    /// Renders the same frame as [`Self::render`], bit for bit. `backdrop` keeps what is likely to be the same in the
    /// next frame. One backdrop belongs to one environment; what it keeps is checked, so that a wrong one costs time
    /// and nothing else. Panics if there is not one pose a body, or the frame has another size.
    pub(crate) fn render_over(
        &mut self,
        backdrop: &mut Backdrop,
        world_from_bodies: &[Pose3],
        world_from_camera: Pose3,
        side: usize,
        depth_mm: &mut [u16],
    ) {
        self.draw_over(backdrop, world_from_bodies, world_from_camera, side);
        depth_mm.copy_from_slice(&backdrop.frame_mm);
        self.buffer.put_before(depth_mm);
    }

    /// The sums of the windows of that frame, as [`proto::camera::sum_windows`] gives them, in a quarter of the memory.
    /// Returns false if they may not fit into 16 bits: then `sums_mm` holds anything. Panics if there is not one pose a
    /// body.
    pub(crate) fn render_sums_over(
        &mut self,
        backdrop: &mut Backdrop,
        world_from_bodies: &[Pose3],
        world_from_camera: Pose3,
        sums_mm: &mut [u16; SUMS_PIXELS],
    ) -> bool {
        self.draw_over(backdrop, world_from_bodies, world_from_camera, FRAME_SIDE);
        let Backdrop { frame_mm, sums, .. } = backdrop;
        let (behind_mm, fit) = sums.get_or_insert_with(|| {
            let fit = sum_windows(frame_mm.as_slice().try_into().expect("drawn above, of this side"), sums_mm);
            (sums_mm.to_vec(), fit)
        });
        sums_mm.copy_from_slice(behind_mm);
        self.buffer.put_before_sums(frame_mm, sums_mm) && *fit
    }

    /// Draws what stands before the backdrop, and before that the backdrop where it has changed.
    fn draw_over(
        &mut self,
        backdrop: &mut Backdrop,
        world_from_bodies: &[Pose3],
        world_from_camera: Pose3,
        side: usize,
    ) {
        let view = self.set_up(world_from_bodies, &world_from_camera, side);
        if backdrop.prepare(&self.scenery.roles, world_from_bodies, &world_from_camera, side) == Redraw::Everything {
            backdrop.view_set_triangles = self.draw(&view, |body| backdrop.holds(body));
            self.buffer.finish(&mut backdrop.frame_mm);
            backdrop.sums = None;
        }
        let before = self.draw(&view, |body| !backdrop.holds(body));
        self.view_set_triangles = backdrop.view_set_triangles + before;
    }

    fn set_up(&mut self, world_from_bodies: &[Pose3], world_from_camera: &Pose3, side: usize) -> View {
        if self.buffer.side() != side {
            self.buffer = DepthBuffer::new(side);
        }
        self.scenery.placed.place(world_from_bodies);
        View::new(Lens::of(side), world_from_camera)
    }

    /// Draws those bodies in view that are `wanted`; returns how many triangles they have at their finest.
    fn draw(&mut self, view: &View, wanted: impl Fn(usize) -> bool) -> usize {
        self.find_in_view(view);
        let Self { scenery: Scenery { placed, .. }, buffer, outline, polyhedra, rounds, in_view, .. } = self;
        let mut triangles = 0;
        let mut last_body = u32::MAX;
        for &(index, centre) in &*in_view {
            let part = &placed.parts[index as usize];
            if !wanted(part.body as usize) {
                continue;
            }
            if part.body != last_body {
                last_body = part.body;
                triangles += placed.triangles(part.body as usize);
            }
            let model = &placed.models[part.model as usize];
            let axis = || view.camera_from_world.vector(part.world_from_part.rotation.map(|row| row[1]));
            match model.form {
                Form::Cuboid | Form::Polyhedron => {
                    let placed = Placed {
                        mesh: model.mesh(),
                        edges: model.edges.as_deref(),
                        is_cuboid: matches!(model.form, Form::Cuboid),
                        vertices: &placed.vertices[part.vertices.clone()],
                        half_spaces: &placed.half_spaces[part.half_spaces.clone()],
                        world_from_part: &part.world_from_part,
                    };
                    polyhedra.draw(buffer, outline, view, &placed);
                }
                _ if centre[2] - model.bounds.radius_m <= NEAR_M => {
                    let camera_from_part = view.camera_from_world.after(&part.world_from_part);
                    polyhedra.clipped(buffer, view.lens, model.mesh(), &camera_from_part);
                }
                Form::Sphere(round) => sphere(buffer, view.lens, centre, round),
                Form::Cylinder(round) => rounds.cylinder(buffer, outline, view.lens, centre, axis(), round),
                Form::Capsule { mantle, ends } => {
                    let axis = axis();
                    for along_m in [mantle.half_height_m, -mantle.half_height_m] {
                        let end = [0, 1, 2].map(|i| centre[i] + along_m * axis[i]);
                        sphere(buffer, view.lens, end, ends);
                    }
                    rounds.cylinder(buffer, outline, view.lens, centre, axis, mantle);
                }
            }
        }
        triangles
    }

    /// Lists the parts whose bounds meet the view volume.
    fn find_in_view(&mut self, view: &View) {
        self.in_view.clear();
        for (block, spheres) in self.scenery.placed.bounds.iter().enumerate() {
            let centre = view.points(spheres.centre.load());
            let mut bits = meets_view(centre, Lanes::load(&spheres.radius_m));
            if bits != 0 {
                let [x, y, z] = centre.map(Lanes::to_array);
                while bits != 0 {
                    let lane = bits.trailing_zeros() as usize;
                    self.in_view.push(((block * LANES + lane) as u32, [x[lane], y[lane], z[lane]]));
                    bits &= bits - 1;
                }
            }
        }
    }
}
