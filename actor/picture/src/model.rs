use super::camera::Camera;
use super::canvas::Rgb;
use super::palette;
use super::robot::{HOLDS, pieces};
use super::walls::Wall;
use rapier3d::math::{Pose3, Vec3};
use simulator::kitchen::{BodyRole, Kitchen};
use simulator::mesh::triangles_of;
use simulator::robot::links::{HAND, PartPoses, part_shapes};
use simulator::shape::Shape;

#[derive(Debug, Clone, Copy)]
pub struct Triangle {
    pub corners: [Vec3; 3],
    pub normal: Vec3,
    pub body: u32,
}

#[derive(Debug, Clone, Default)]
pub struct Model {
    pub triangles: Vec<Triangle>,
    pub colours: Vec<Rgb>,
    /// sRGB colour of each body where a section cuts it.
    pub sections: Vec<Rgb>,
    pub movable: Vec<bool>,
    /// Bodies that no shadow falls on: light is kept from picture to picture, and they move.
    pub open: Vec<bool>,
    walls: Vec<Wall>,
}

impl Model {
    /// The settled kitchen without ceiling and robot.
    pub fn of(kitchen: &Kitchen) -> Self {
        let mut model = Self::default();
        for (body, pose) in kitchen.bodies().iter().zip(kitchen.settled_poses()) {
            if body.role != BodyRole::Robot && body.category != "Ceiling" {
                let colour = palette::colour(&body.category, kitchen.id().number());
                model.add(&body.shape, pose, colour, body.role == BodyRole::Movable);
            }
        }
        model
    }

    pub fn fixed_of(kitchen: &Kitchen) -> Self {
        let mut model = Self::default();
        let fixed = kitchen.static_bodies();
        let mut walls = Vec::new();
        for (body, pose) in kitchen.bodies()[fixed.clone()].iter().zip(&kitchen.settled_poses()[fixed]) {
            if body.category == "Wall" {
                walls.push(model.colours.len() as u32);
            }
            if body.category != "Ceiling" {
                model.add(&body.shape, pose, palette::colour(&body.category, kitchen.id().number()), false);
            }
        }
        model.walls = Wall::of(&model.bounds_of_bodies(), |body| walls.contains(&body));
        model
    }

    /// Adds the kitchen's movable things in these poses; `colour`: of a thing by its place among them, if it is not to
    /// have its own. Returns the first one's number among the bodies.
    pub fn add_things(&mut self, kitchen: &Kitchen, poses: &[Pose3], colour: impl Fn(usize) -> Option<Rgb>) -> u32 {
        let first = self.colours.len() as u32;
        for (index, (body, pose)) in kitchen.bodies()[kitchen.movable_bodies()].iter().zip(poses).enumerate() {
            let colour = colour(index).unwrap_or_else(|| palette::colour(&body.category, kitchen.id().number()));
            self.add(&body.shape, pose, colour, true);
        }
        first
    }

    /// Adds the robot in these poses as people see it, with or without its body, in which the head camera sits; its hand
    /// has another colour while it holds something.
    pub fn add_robot(&mut self, poses: &PartPoses, with_body: bool, is_holding: bool) {
        for piece in pieces().iter().filter(|piece| with_body || piece.part != 0) {
            let colour = if is_holding && piece.part == HAND { HOLDS } else { piece.colour };
            self.add(&piece.shape, &poses[piece.part], colour, false);
            let body = self.colours.len() - 1;
            (self.sections[body], self.open[body]) = (colour, true);
        }
    }

    /// Adds the arm that the depth camera sees in these poses.
    pub fn add_arm(&mut self, poses: &PartPoses) {
        part_shapes().iter().zip(poses).skip(1).for_each(|(shape, pose)| self.add(shape, pose, palette::ROBOT, false));
    }

    /// Takes the kitchen's movable things of these places, the first of which is body `first`, out of the picture.
    pub fn take_away(&mut self, first: u32, things: &[usize]) {
        self.triangles.retain(|triangle| {
            triangle.body.checked_sub(first).is_none_or(|thing| !things.contains(&(thing as usize)))
        });
    }

    pub fn add(&mut self, shape: &Shape, world_from_body: &Pose3, colour: Rgb, movable: bool) {
        let body = self.colours.len() as u32;
        self.colours.push(colour);
        self.sections.push(palette::SECTION);
        self.movable.push(movable);
        self.open.push(false);
        for corners in triangles_of(shape) {
            let corners = corners.map(|corner| *world_from_body * Vec3::from(corner));
            let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or_zero();
            self.triangles.push(Triangle { corners, normal, body });
        }
    }

    /// Its triangles and their numbers without the walls that hide the room from this camera.
    pub fn before(&self, camera: &Camera) -> impl Iterator<Item = (u32, &Triangle)> + '_ {
        let eye = camera.camera_from_world.inverse().translation;
        let mut left_out = vec![false; self.colours.len()];
        for body in self.walls.iter().filter(|wall| wall.hides_from(eye)).flat_map(|wall| &wall.bodies) {
            left_out[*body as usize] = true;
        }
        (0..).zip(&self.triangles).filter(move |(_, triangle)| !left_out[triangle.body as usize])
    }

    pub fn corners(&self) -> impl Iterator<Item = [Vec3; 3]> + '_ {
        self.triangles.iter().map(|triangle| triangle.corners)
    }

    fn bounds_of_bodies(&self) -> Vec<(Vec3, Vec3)> {
        let mut bounds = vec![(Vec3::splat(f32::MAX), Vec3::splat(f32::MIN)); self.colours.len()];
        for triangle in &self.triangles {
            let body = &mut bounds[triangle.body as usize];
            *body = triangle.corners.iter().fold(*body, |(low, high), at| (low.min(*at), high.max(*at)));
        }
        bounds
    }

    pub fn bounds(&self) -> (Vec3, Vec3) {
        let begin = (Vec3::splat(f32::MAX), Vec3::splat(f32::MIN));
        self.corners().flatten().fold(begin, |(low, high), corner| (low.min(corner), high.max(corner)))
    }
}
