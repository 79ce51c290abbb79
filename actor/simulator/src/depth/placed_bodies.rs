//! Bodies as the camera keeps them: every part placed in the world, numbers of a kind side by side for the vector unit.
//!
//! A part is placed anew only when its body's pose has changed, bit for bit; most never move.

use super::round::Round;
use super::simd::{LANES, Lanes};
use super::view::Rigid;
use crate::kitchen::Body;
use crate::mesh::{Edge, Mesh, Sphere, sides, sides_of_sphere, triangles_of};
use crate::shape::Primitive;
use rapier3d::math::Pose3;
use std::ops::Range;

/// Eight points, metres, or directions: their x, y and z.
#[derive(Debug, Clone, Copy, Default)]
pub struct Points([[f32; LANES]; 3]);

/// Eight spheres.
#[derive(Debug, Clone, Copy, Default)]
pub struct Spheres {
    pub centre: Points,
    pub radius_m: [f32; LANES],
}

/// Eight planes normal · p = offset.
#[derive(Debug, Clone, Copy, Default)]
pub struct HalfSpaces {
    pub normal: Points,
    pub offset_m: [f32; LANES],
}

impl Points {
    fn set(&mut self, lane: usize, p: [f32; 3]) {
        self.0.iter_mut().zip(p).for_each(|(axis, value)| axis[lane] = value);
    }

    /// All of them, by axis.
    #[inline(always)]
    pub fn load(&self) -> [Lanes; 3] {
        self.0.each_ref().map(Lanes::load)
    }
}

/// A mesh, shared by all parts of its shape.
#[derive(Debug, Clone)]
pub struct Model {
    pub mesh: Mesh,
    /// None if the mesh is dented or not closed: its outline is not known then, and it is drawn face by face.
    pub edges: Option<Vec<Edge>>,
    pub bounds: Sphere,
    pub form: Form,
}

/// How a part is drawn.
#[derive(Debug, Clone, Copy)]
pub enum Form {
    Cuboid,
    Polyhedron,
    Cylinder(Round),
    Sphere(Round),
    /// A cylinder and a sphere at each of its ends.
    Capsule {
        mantle: Round,
        ends: Round,
    },
}

/// A part, placed in the world.
#[derive(Debug, Clone)]
pub struct PartView {
    pub body: u32,
    pub model: u32,
    pub body_from_part: Rigid,
    pub world_from_part: Rigid,
    /// Blocks of the points and half-spaces, if it is drawn from its mesh.
    pub vertices: Range<usize>,
    pub half_spaces: Range<usize>,
}

/// What is known of one body.
#[derive(Debug, Clone)]
struct BodyView {
    parts: Range<usize>,
    triangles: usize,
    /// Where its parts are placed; none before the first image.
    pose: Option<[u32; 7]>,
}

/// All bodies.
#[derive(Debug, Clone)]
pub struct PlacedBodies {
    bodies: Vec<BodyView>,
    pub models: Vec<Model>,
    pub parts: Vec<PartView>,
    /// Around the parts.
    pub bounds: Vec<Spheres>,
    pub vertices: Vec<Points>,
    pub half_spaces: Vec<HalfSpaces>,
}

/// The bits of a pose.
pub fn pose_bits(pose: &Pose3) -> [u32; 7] {
    let (q, t) = (pose.rotation, pose.translation);
    [q.x, q.y, q.z, q.w, t.x, t.y, t.z].map(f32::to_bits)
}

impl Model {
    fn of(primitive: &Primitive) -> Self {
        let mesh = Mesh::of(primitive);
        let form = match *primitive {
            Primitive::Cuboid { .. } => Form::Cuboid,
            Primitive::Hull { .. } | Primitive::Concave(_) => Form::Polyhedron,
            Primitive::Cylinder { radius_m, half_height_m } => {
                Form::Cylinder(Round::cylinder(radius_m, half_height_m, sides(radius_m)))
            }
            Primitive::Sphere { radius_m } => Form::Sphere(Round::sphere(radius_m, sides_of_sphere(radius_m))),
            Primitive::Capsule { radius_m, half_height_m } => {
                let sides = sides_of_sphere(radius_m);
                Form::Capsule {
                    mantle: Round::cylinder(radius_m, half_height_m, sides),
                    ends: Round::sphere(radius_m, sides),
                }
            }
        };
        // A box without thickness has fewer faces, and no table fits it.
        let form = if matches!(form, Form::Cuboid) && mesh.faces.len() != 6 { Form::Polyhedron } else { form };
        let edges = if matches!(primitive, Primitive::Concave(_)) { None } else { mesh.edges() };
        Self { edges, bounds: mesh.bounds(), mesh, form }
    }
}

impl PlacedBodies {
    /// These bodies, not placed yet.
    pub fn new(bodies: &[Body]) -> Self {
        let mut placed = Self {
            bodies: Vec::new(),
            models: Vec::new(),
            parts: Vec::new(),
            bounds: Vec::new(),
            vertices: Vec::new(),
            half_spaces: Vec::new(),
        };
        let mut primitives: Vec<&Primitive> = Vec::new();
        for (number, body) in bodies.iter().enumerate() {
            let first = placed.parts.len();
            for part in &body.shape.parts {
                let known = primitives.iter().position(|&known| *known == part.primitive);
                let model = known.unwrap_or_else(|| {
                    primitives.push(&part.primitive);
                    placed.models.push(Model::of(&part.primitive));
                    primitives.len() - 1
                });
                placed.add(number, model, Rigid::from_pose(&part.body_from_part));
            }
            let parts = first..placed.parts.len();
            placed.bodies.push(BodyView { parts, triangles: triangles_of(&body.shape).len(), pose: None });
        }
        // What is left of the last block is nowhere to be seen.
        let nowhere = Spheres { radius_m: [f32::MIN; LANES], ..Spheres::default() };
        placed.bounds = vec![nowhere; placed.parts.len().div_ceil(LANES)];
        placed
    }

    fn add(&mut self, body: usize, model: usize, body_from_part: Rigid) {
        let Model { mesh, form, .. } = &self.models[model];
        let (first_point, first_half_space) = (self.vertices.len(), self.half_spaces.len());
        if matches!(form, Form::Cuboid | Form::Polyhedron) {
            let blocks = |count: usize| count.div_ceil(LANES);
            self.vertices.resize(first_point + blocks(mesh.vertices.len()), Points::default());
            // No eye is above a half-space without a face.
            let none = HalfSpaces { offset_m: [1.0; LANES], ..HalfSpaces::default() };
            self.half_spaces.resize(first_half_space + blocks(mesh.faces.len()), none);
        }
        self.parts.push(PartView {
            body: body as u32,
            model: model as u32,
            body_from_part,
            world_from_part: body_from_part,
            vertices: first_point..self.vertices.len(),
            half_spaces: first_half_space..self.half_spaces.len(),
        });
    }

    /// Number of bodies.
    pub fn body_count(&self) -> usize {
        self.bodies.len()
    }

    /// Triangles of a body's finest mesh.
    pub fn triangles(&self, body: usize) -> usize {
        self.bodies[body].triangles
    }

    /// Places every body that is not where it was.
    pub fn place(&mut self, world_from_bodies: &[Pose3]) {
        assert_eq!(world_from_bodies.len(), self.bodies.len(), "one pose a body");
        for (number, pose) in world_from_bodies.iter().enumerate() {
            let bits = pose_bits(pose);
            if self.bodies[number].pose != Some(bits) {
                self.bodies[number].pose = Some(bits);
                let world_from_body = Rigid::from_pose(pose);
                for part in self.bodies[number].parts.clone() {
                    self.place_part(part, &world_from_body);
                }
            }
        }
    }

    fn place_part(&mut self, index: usize, world_from_body: &Rigid) {
        let part = &mut self.parts[index];
        let world_from_part = world_from_body.after(&part.body_from_part);
        part.world_from_part = world_from_part;
        let Model { mesh, bounds, form, .. } = &self.models[part.model as usize];
        let spheres = &mut self.bounds[index / LANES];
        spheres.centre.set(index % LANES, world_from_part.point(bounds.centre));
        spheres.radius_m[index % LANES] = bounds.radius_m;
        if !matches!(form, Form::Cuboid | Form::Polyhedron) {
            return;
        }
        let vertices = &mut self.vertices[part.vertices.clone()];
        // What is left of the last block repeats a vertex.
        for i in 0..vertices.len() * LANES {
            let vertex = mesh.vertices[if i < mesh.vertices.len() { i } else { 0 }];
            vertices[i / LANES].set(i % LANES, world_from_part.point(vertex));
        }
        let half_spaces = &mut self.half_spaces[part.half_spaces.clone()];
        for (i, face) in mesh.faces.iter().enumerate() {
            let normal = world_from_part.vector(face.normal);
            let t = world_from_part.translation;
            let block = &mut half_spaces[i / LANES];
            block.normal.set(i % LANES, normal);
            block.offset_m[i % LANES] = face.offset_m + normal[0] * t[0] + normal[1] * t[1] + normal[2] * t[2];
        }
    }
}
