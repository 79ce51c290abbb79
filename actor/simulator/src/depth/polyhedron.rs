//! Boxes and hulls, drawn from their planes: the outline of the faces that look at the eye, and within it the least of
//! those faces' inverse depths.

use super::depth_buffer::{Corner, DepthBuffer, Extent, rectangle};
use super::outline::{Corners, Outline};
use super::placed_bodies::{HalfSpaces, Points};
use super::surface::{ManyPlanes, Plane, Planes};
use super::view::{LEAST_HEIGHT_M, Lens, NEAR_M, Rigid, TAN_HALF_FIELD_OF_VIEW, View, clip_near, dot};
use crate::mesh::{Edge, Face, Mesh};
use crate::shape::Primitive;
use depth::simd::{LANES, Lanes, Mask};
use rapier3d::math::Vec3;

/// From this many groups of pixels on, a hull is drawn face by face: to compare all of its planes at each pixel then
/// takes longer than to find the edges between them.
const FACE_BY_FACE_GROUPS: f32 = 256.0;
/// All of eight points.
const ALL: u32 = 255;

/// Draws polyhedra; its buffers live from call to call.
#[derive(Debug, Clone, Default)]
pub struct PolyhedronBrush {
    cuboids: CuboidOutlines,
    /// Vertices of the part at hand, in the image.
    x_px: Vec<[f32; LANES]>,
    y_px: Vec<[f32; LANES]>,
    inverse_m: Vec<[f32; LANES]>,
    /// Which faces of the part at hand look at the eye, and their planes.
    front: Vec<bool>,
    front_faces: Vec<u16>,
    planes: ManyPlanes,
    /// The face at hand, in the image.
    corners: Vec<Corner>,
    /// The face at hand, camera's frame, before and after clipping.
    polygon: Vec<[f32; 3]>,
    clipped: Vec<[f32; 3]>,
}

/// A mesh placed in the world: the edges are not known if it is not closed.
#[derive(Debug, Clone, Copy)]
pub struct Placed<'a> {
    pub mesh: &'a Mesh,
    pub edges: Option<&'a [Edge]>,
    pub is_cuboid: bool,
    pub vertices: &'a [Points],
    pub half_spaces: &'a [HalfSpaces],
    pub world_from_part: &'a Rigid,
}

enum Seen {
    Outside,
    /// Some lie nearer than the near plane.
    Cut,
    /// In these rows, with groups of pixels in the rectangle around them, and the last eight vertices.
    Whole {
        extent: Extent,
        groups: f32,
        last: Corners,
    },
}

impl PolyhedronBrush {
    pub fn draw(&mut self, buffer: &mut DepthBuffer, outline: &mut Outline, view: &View, placed: &Placed) {
        let side = buffer.side() as f32;
        let (extent, groups, last) = match self.project(view, placed.vertices, side) {
            Seen::Outside => return,
            Seen::Cut => {
                self.clipped(buffer, view.lens, placed.mesh, &view.camera_from_world.after(placed.world_from_part));
                return;
            }
            Seen::Whole { extent, groups, last } => (extent, groups, last),
        };
        let front_bits = self.find_front(view, placed.half_spaces);
        let count = self.planes.len();
        if count == 0 {
            return;
        }
        outline.clear();
        match placed.edges {
            _ if placed.is_cuboid => {
                // Its eight vertices are the last eight.
                let Some([from, to]) = self.cuboids.get(front_bits) else { return };
                let pick = |which| Corners { x_px: last.x_px.pick(which), y_px: last.y_px.pick(which) };
                outline.add(pick(from), pick(to), side);
            }
            Some(edges) if groups < FACE_BY_FACE_GROUPS => self.add_outline(outline, edges, side),
            _ => {
                self.face_by_face(buffer, placed.mesh);
                return;
            }
        }
        outline.mark(buffer, extent.top, extent.bottom);
        match count {
            1 => buffer.sweep(extent, &mut Planes::<1>::new(self.planes.first())),
            2 => buffer.sweep(extent, &mut Planes::<2>::new(self.planes.first())),
            3 => buffer.sweep(extent, &mut Planes::<3>::new(self.planes.first())),
            _ => buffer.sweep(extent, &mut self.planes),
        }
    }

    #[inline(always)]
    fn project(&mut self, view: &View, vertices: &[Points], side: f32) -> Seen {
        self.x_px.resize(vertices.len(), [0.0; LANES]);
        self.y_px.resize(vertices.len(), [0.0; LANES]);
        self.inverse_m.resize(vertices.len(), [0.0; LANES]);
        let (mut farthest, mut nearest) = (Lanes::splat(f32::MAX), Lanes::splat(0.0));
        let (mut low, mut high) = ([Lanes::splat(f32::MAX); 2], [Lanes::splat(f32::MIN); 2]);
        let (mut cut, mut outside) = (0, [ALL; 5]);
        let mut last = Corners { x_px: low[0], y_px: low[1] };
        for (block, points) in vertices.iter().enumerate() {
            let p = view.points(points.load());
            let behind = p[2].less(Lanes::splat(NEAR_M)).bits();
            let reach = p[2] * Lanes::splat(TAN_HALF_FIELD_OF_VIEW);
            let back = Lanes::splat(0.0) - reach;
            let [left, right, below, above] =
                [p[0].less(back), reach.less(p[0]), p[1].less(back), reach.less(p[1])].map(Mask::bits);
            cut |= behind;
            outside.iter_mut().zip([left, right, below, above, behind]).for_each(|(all, bits)| *all &= bits);
            let (corners, inverse_m) = view.lens.project_lanes(p);
            farthest = farthest.min(inverse_m);
            nearest = nearest.max(inverse_m);
            low = [low[0].min(corners.x_px), low[1].min(corners.y_px)];
            high = [high[0].max(corners.x_px), high[1].max(corners.y_px)];
            corners.x_px.store(&mut self.x_px[block]);
            corners.y_px.store(&mut self.y_px[block]);
            inverse_m.store(&mut self.inverse_m[block]);
            last = corners;
        }
        // All of its vertices lie outside of one side of the view volume.
        if outside.contains(&ALL) {
            return Seen::Outside;
        }
        if cut != 0 {
            return Seen::Cut;
        }
        let Some([left, right, top, bottom]) = rectangle(low, high, side) else { return Seen::Outside };
        let extent =
            Extent { top: top as usize, bottom: bottom as usize, inverse_m: [farthest.smallest(), nearest.largest()] };
        Seen::Whole { extent, groups: (bottom - top) * ((right - left) / LANES as f32 + 1.0), last }
    }

    /// Finds the faces that look at the eye, and their planes. The bits are those of the first eight faces.
    #[inline(always)]
    fn find_front(&mut self, view: &View, half_spaces: &[HalfSpaces]) -> u32 {
        self.planes.clear();
        self.front_faces.clear();
        self.front.clear();
        let mut first_bits = 0;
        for (block, half_spaces) in half_spaces.iter().enumerate() {
            let normal = half_spaces.normal.load();
            let height_m = dot(normal, view.eye.map(Lanes::splat)) - Lanes::load(&half_spaces.offset_m);
            let mut bits = Lanes::splat(LEAST_HEIGHT_M).less(height_m).bits();
            if block == 0 {
                first_bits = bits;
            }
            self.front.extend((0..LANES).map(|lane| bits >> lane & 1 != 0));
            let per_height = Lanes::splat(-1.0) / height_m;
            let [at_origin, per_x, per_y] =
                view.ray.map(|ray| (dot(normal, ray.map(Lanes::splat)) * per_height).to_array());
            while bits != 0 {
                let lane = bits.trailing_zeros() as usize;
                self.planes.push(Plane { at_origin: at_origin[lane], per_x: per_x[lane], per_y: per_y[lane] });
                self.front_faces.push((block * LANES + lane) as u16);
                bits &= bits - 1;
            }
        }
        first_bits
    }

    /// Adds the edges between a face that looks at the eye and one that does not.
    #[inline(always)]
    fn add_outline(&self, outline: &mut Outline, edges: &[Edge], side: f32) {
        let (x_px, y_px) = (self.x_px.as_flattened(), self.y_px.as_flattened());
        // [from, to][x, y]
        let mut ends = [[[0.0; LANES]; 2]; 2];
        let mut filled = 0;
        let add = |outline: &mut Outline, ends: &[[[f32; LANES]; 2]; 2]| {
            let [from, to] = [0, 1].map(|i| {
                let [x_px, y_px]: &[[f32; LANES]; 2] = &ends[i];
                Corners { x_px: Lanes::load(x_px), y_px: Lanes::load(y_px) }
            });
            outline.add(from, to, side);
        };
        for edge in edges {
            let [first, second] = edge.faces.map(|face| self.front[usize::from(face)]);
            if first == second {
                continue;
            }
            let [a, b] = edge.ends.map(usize::from);
            for (end, vertex) in ends.iter_mut().zip(if first { [a, b] } else { [b, a] }) {
                end[0][filled] = x_px[vertex];
                end[1][filled] = y_px[vertex];
            }
            filled += 1;
            if filled == LANES {
                add(outline, &ends);
                filled = 0;
            }
        }
        // Sides without length are none.
        ends.as_flattened_mut().iter_mut().for_each(|numbers| numbers[filled..].fill(0.0));
        add(outline, &ends);
    }

    /// Draws the faces that look at the eye one by one.
    fn face_by_face(&mut self, buffer: &mut DepthBuffer, mesh: &Mesh) {
        let (x_px, y_px) = (self.x_px.as_flattened(), self.y_px.as_flattened());
        let inverse_m = self.inverse_m.as_flattened();
        for (number, &face) in self.front_faces.iter().enumerate() {
            let corners = corners_of(mesh, mesh.faces[usize::from(face)]).iter().map(|&i| {
                let i = usize::from(i);
                Corner::new(x_px[i], y_px[i], inverse_m[i], buffer.side())
            });
            self.corners.clear();
            self.corners.extend(corners);
            buffer.fill(&self.corners, self.planes.get(number));
        }
    }

    /// Draws a convex mesh face by face, cut at the near plane.
    pub fn clipped(&mut self, buffer: &mut DepthBuffer, lens: Lens, mesh: &Mesh, camera_from_part: &Rigid) {
        let eye = camera_from_part.origin_of_target();
        for &face in &mesh.faces {
            let n = face.normal;
            let height_m = n[0] * eye[0] + n[1] * eye[1] + n[2] * eye[2] - face.offset_m;
            // The eye is behind it: the face looks away.
            if height_m <= LEAST_HEIGHT_M {
                continue;
            }
            let corners = corners_of(mesh, face).iter();
            self.polygon.clear();
            self.polygon.extend(corners.map(|&i| camera_from_part.point(mesh.vertices[usize::from(i)])));
            clip_near(&self.polygon, &mut self.clipped);
            if self.clipped.len() < 3 {
                continue;
            }
            self.corners.clear();
            self.corners.extend(self.clipped.iter().map(|&p| lens.project(p)));
            buffer.fill(&self.corners, lens.plane(camera_from_part.vector(n), height_m));
        }
    }
}

fn corners_of(mesh: &Mesh, face: Face) -> &[u16] {
    &mesh.corners[face.first as usize..(face.first + face.count) as usize]
}

/// The outline of a box for each set of its faces that look at the eye: where each side begins and ends, clockwise on
/// the screen. Sides that are left over have no length.
#[derive(Debug, Clone)]
struct CuboidOutlines(Vec<Option<[[i32; LANES]; 2]>>);

impl Default for CuboidOutlines {
    fn default() -> Self {
        let mesh = Mesh::of(&Primitive::Cuboid { half_extents_m: Vec3::ONE });
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
                        // Opposite faces both look at the eye: there is no such box.
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
}

impl CuboidOutlines {
    fn get(&self, front: u32) -> Option<&[[i32; LANES]; 2]> {
        self.0.get(front as usize)?.as_ref()
    }
}
