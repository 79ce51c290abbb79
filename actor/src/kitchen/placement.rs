//! Where movable things stand: drawn at random, without overlap, before physics has its say.

use super::catalogue::{CATEGORIES, Category, Place};
use super::layout::Layout;
use super::room::{Surface, Thing};
use crate::physics::geometry::{Solid, rotation_y};
use crate::physics::scene::Scene;
use proto::random::Random;
use rapier3d::geometry::Aabb;
use rapier3d::math::{Pose3, Vec3};
use rapier3d::parry::bounding_volume::BoundingVolume;
use std::f32::consts::PI;

/// Gap between the bounding boxes of two things, metres.
const GAP_M: f32 = 0.02;
/// Things are set down from this height, metres.
pub const DROP_M: f32 = 0.001;
const TRIES: u32 = 600;

/// Draws which things a kitchen holds and where they stand. The error is the category that found no room.
pub fn place(layout: &Layout, scene: &Scene, random: &mut Random) -> Result<Vec<Thing>, &'static str> {
    let mut placed: Vec<Thing> = Vec::new();
    let mut taken: Vec<Aabb> = Vec::new();
    for category in CATEGORIES.iter() {
        let wanted = if random.uniform() < category.share() { 1 + random.below(category.most()) } else { 0 };
        for _ in 0..wanted {
            let shape = category.shape();
            let solid = Solid::of(&shape);
            match find(category, &solid, layout, scene, &taken, random) {
                Some(pose) => {
                    taken.push(solid.aabb(&pose).loosened(GAP_M));
                    placed.push(Thing {
                        category: category.name.to_owned(),
                        shape,
                        solid,
                        mass_kg: category.mass_kg,
                        friction: category.friction(),
                        pose,
                    });
                }
                None if category.share() >= 1.0 => return Err(category.name),
                None => {}
            }
        }
    }
    Ok(placed)
}

fn find(
    category: &Category,
    solid: &Solid,
    layout: &Layout,
    scene: &Scene,
    taken: &[Aabb],
    random: &mut Random,
) -> Option<Pose3> {
    let (floor_low, floor_high) = layout.floor?;
    let half_height = 0.5 * solid.aabb(&Pose3::identity()).extents().y;
    let area: f32 = layout.surfaces.iter().map(Surface::area_m2).sum();
    for _ in 0..TRIES {
        let (pose, surface) = match category.place {
            Place::Seat => {
                let (x, z, yaw) = seat(layout, floor_low, floor_high, random);
                (Pose3::from_parts(Vec3::new(x, half_height + DROP_M, z), rotation_y(yaw)), None)
            }
            Place::Floor => {
                let x = random.range(floor_low.x + 0.25, floor_high.x - 0.25);
                let z = random.range(floor_low.z + 0.25, floor_high.z - 0.25);
                let yaw = rotation_y(random.range(-PI, PI));
                (Pose3::from_parts(Vec3::new(x, half_height + DROP_M, z), yaw), None)
            }
            _ => {
                let surface = pick(&layout.surfaces, area, random)?;
                let x = random.range(surface.low.x, surface.high.x);
                let z = random.range(surface.low.z, surface.high.z);
                let yaw = rotation_y(random.range(-PI, PI));
                (Pose3::from_parts(Vec3::new(x, surface.low.y + half_height + DROP_M, z), yaw), Some(surface))
            }
        };
        let whole = solid.aabb(&pose);
        let clear = surface.is_none_or(|surface| surface.carries(&whole))
            && parts_clear(solid, &pose, scene)
            && !taken.iter().any(|other| other.intersects(&whole));
        if clear {
            return Some(pose);
        }
    }
    None
}

/// Whether every part's bounding box keeps clear of everything fixed.
fn parts_clear(solid: &Solid, pose: &Pose3, scene: &Scene) -> bool {
    // Less than the height from which things are set down, so that what they stand on does not count.
    const MARGIN_M: f32 = 0.5 * DROP_M;
    solid.parts.iter().all(|(shape, body_from_part)| {
        !scene.meets_aabb(&shape.compute_aabb(&(*pose * *body_from_part)).loosened(MARGIN_M))
    })
}

/// A surface, with probability by area.
fn pick(surfaces: &[Surface], area: f32, random: &mut Random) -> Option<Surface> {
    let mut at = random.uniform() * area;
    for surface in surfaces {
        at -= surface.area_m2();
        if at < 0.0 {
            return Some(*surface);
        }
    }
    surfaces.last().copied()
}

/// Beside the table, facing it; anywhere on the floor without one.
fn seat(layout: &Layout, floor_low: Vec3, floor_high: Vec3, random: &mut Random) -> (f32, f32, f32) {
    let wobble = random.range(-0.15, 0.15);
    let Some((middle, half)) = layout.table else {
        let x = random.range(floor_low.x + 0.3, floor_high.x - 0.3);
        let z = random.range(floor_low.z + 0.3, floor_high.z - 0.3);
        return (x, z, random.range(-PI, PI));
    };
    let side = random.below(4);
    let away = random.range(0.0, 0.25);
    let slide = random.range(-0.5, 0.5);
    match side {
        0 => (middle.x + slide * half.x, middle.z - half.z - away, wobble),
        1 => (middle.x + slide * half.x, middle.z + half.z + away, PI + wobble),
        2 => (middle.x - half.x - away, middle.z + slide * half.z, 0.5 * PI + wobble),
        _ => (middle.x + half.x + away, middle.z + slide * half.z, -0.5 * PI + wobble),
    }
}
