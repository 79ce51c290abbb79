//! Bodies as the camera keeps them: every part placed in the world, numbers of a kind side by side for the vector unit.
//!
//! A part is placed anew only when its body's pose has changed, bit for bit; most never move.

use super::model::{Form, Model, Models};
use super::view::Rigid;
use crate::kitchen::Body;
use depth::simd::{LANES, Lanes};
use rapier3d::math::Pose3;
use std::ops::Range;
use std::sync::Arc;

/// Eight points, metres, or directions: their x, y and z.
#[derive(Debug, Clone, Copy, Default)]
pub struct Points([[f32; LANES]; 3]);

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

#[derive(Debug, Clone)]
struct BodyView {
    parts: Range<usize>,
    triangles: usize,
    /// Where its parts are placed; none before the first image.
    pose: Option<[u32; 7]>,
}

#[derive(Debug, Clone, Default)]
pub struct PlacedBodies {
    bodies: Vec<BodyView>,
    pub models: Vec<Arc<Model>>,
    pub parts: Vec<PartView>,
    pub bounds: Vec<Spheres>,
    pub vertices: Vec<Points>,
    pub half_spaces: Vec<HalfSpaces>,
}

pub fn pose_bits(pose: &Pose3) -> [u32; 7] {
    let (q, t) = (pose.rotation, pose.translation);
    [q.x, q.y, q.z, q.w, t.x, t.y, t.z].map(f32::to_bits)
}

impl PlacedBodies {
    pub fn new(bodies: &[Body]) -> Self {
        let mut placed = Self::default();
        let mut models = Models::default();
        for (number, body) in bodies.iter().enumerate() {
            let first = placed.parts.len();
            let mut triangles = 0;
            for part in &body.shape.parts {
                let model = models.number_of(&part.primitive);
                triangles += models.list[model].triangles;
                placed.add(number, model, &models.list[model], Rigid::from_pose(&part.body_from_part));
            }
            let parts = first..placed.parts.len();
            placed.bodies.push(BodyView { parts, triangles, pose: None });
        }
        placed.models = models.list;
        // What is left of the last block is nowhere to be seen.
        let nowhere = Spheres { radius_m: [f32::MIN; LANES], ..Spheres::default() };
        placed.bounds = vec![nowhere; placed.parts.len().div_ceil(LANES)];
        placed
    }

    fn add(&mut self, body: usize, number: usize, model: &Model, body_from_part: Rigid) {
        let (first_point, first_half_space) = (self.vertices.len(), self.half_spaces.len());
        if matches!(model.form, Form::Cuboid | Form::Polyhedron) {
            let blocks = |count: usize| count.div_ceil(LANES);
            let mesh = model.mesh();
            self.vertices.resize(first_point + blocks(mesh.vertices.len()), Points::default());
            // No eye is above a half-space without a face.
            let none = HalfSpaces { offset_m: [1.0; LANES], ..HalfSpaces::default() };
            self.half_spaces.resize(first_half_space + blocks(mesh.faces.len()), none);
        }
        self.parts.push(PartView {
            body: body as u32,
            model: number as u32,
            body_from_part,
            world_from_part: body_from_part,
            vertices: first_point..self.vertices.len(),
            half_spaces: first_half_space..self.half_spaces.len(),
        });
    }

    pub fn body_count(&self) -> usize {
        self.bodies.len()
    }

    pub fn triangles(&self, body: usize) -> usize {
        self.bodies[body].triangles
    }

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
        let model = &self.models[part.model as usize];
        let Model { bounds, form, .. } = &**model;
        let spheres = &mut self.bounds[index / LANES];
        spheres.centre.set(index % LANES, world_from_part.point(bounds.centre));
        spheres.radius_m[index % LANES] = bounds.radius_m;
        if !matches!(form, Form::Cuboid | Form::Polyhedron) {
            return;
        }
        let mesh = model.mesh();
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
