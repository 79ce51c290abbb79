//! Categories of movable things as data: dimensions, masses, and how often iTHOR's kitchens have them.
//!
//! Dimensions are those of common household things, metres; masses kilograms. Shapes stand upright on y = 0 as they
//! are written here and are then centred. Round things have a flat underside: rapier has no rolling friction, so a
//! sphere on a counter would never come to rest.

use crate::physics::geometry::centred;
use crate::shape::{Primitive, Shape};
use rapier3d::math::Vec3;
use std::f32::consts::PI;

/// Where things of a category stand.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// On a counter, table or shelf.
    Surface,
    /// On the floor by the dining table (anywhere on the floor if there is none).
    Seat,
    /// On the floor.
    Floor,
}

/// Coulomb friction coefficient of common household materials on each other.
const FRICTION: f32 = 0.6;

/// One category of movable things.
#[derive(Debug, Clone, Copy)]
pub struct Category {
    /// iTHOR's name.
    pub name: &'static str,
    /// Mass, kilograms.
    pub mass_kg: f32,
    /// Coulomb friction coefficient of its surface.
    pub friction: f32,
    /// Where it stands.
    pub place: Place,
    /// Share of the kitchens that have it (reference statistics).
    pub share: f32,
    /// Most of them in one kitchen.
    pub most: u32,
    shape: fn() -> Shape,
}

impl Category {
    /// Its shape, origin at the centre of the bounding box.
    pub fn shape(&self) -> Shape {
        centred((self.shape)())
    }
}

const fn small(name: &'static str, mass_kg: f32, shape: fn() -> Shape) -> Category {
    Category { name, mass_kg, friction: FRICTION, place: Place::Surface, share: 1.0, most: 1, shape }
}

const fn some(name: &'static str, mass_kg: f32, share: f32, most: u32, shape: fn() -> Shape) -> Category {
    Category { name, mass_kg, friction: FRICTION, place: Place::Surface, share, most, shape }
}

/// All movable categories, largest footprint first: placement goes down this list.
pub const CATEGORIES: [Category; 41] = [
    Category { name: "Chair", mass_kg: 5.5, friction: FRICTION, place: Place::Seat, share: 0.4, most: 3, shape: chair },
    Category {
        name: "Stool",
        mass_kg: 4.0,
        friction: FRICTION,
        place: Place::Seat,
        share: 0.47,
        most: 2,
        shape: stool,
    },
    Category {
        name: "GarbageCan",
        mass_kg: 1.8,
        friction: FRICTION,
        place: Place::Floor,
        share: 1.0,
        most: 1,
        shape: garbage_can,
    },
    small("CoffeeMachine", 3.2, coffee_machine),
    small("Toaster", 1.6, toaster),
    some("HousePlant", 1.8, 0.33, 1, house_plant),
    some("Kettle", 1.1, 0.5, 1, kettle),
    small("Pan", 1.0, pan),
    small("Pot", 1.4, pot),
    small("Bread", 0.7, bread),
    small("Plate", 0.5, plate),
    small("Spatula", 0.1, spatula),
    some("Ladle", 0.15, 0.33, 1, ladle),
    small("Knife", 0.15, || cutlery(0.18, 0.030, 0.11, 0.020)),
    some("Book", 0.6, 0.07, 1, || block(0.22, 0.03, 0.15)),
    small("Lettuce", 0.5, || globe(0.075, 0.13)),
    small("Bowl", 0.4, || lathe(&[(0.04, 0.0), (0.07, 0.04), (0.075, 0.065)], 12, 1.0)),
    some("PaperTowelRoll", 0.5, 0.33, 1, || upright(0.06, 0.26)),
    some("Vase", 0.8, 0.2, 2, || lathe(&[(0.04, 0.0), (0.06, 0.09), (0.03, 0.2)], 10, 1.0)),
    some("WineBottle", 1.2, 0.33, 1, || bottle(0.037, 0.20, 0.014, 0.10)),
    some("Bottle", 0.6, 0.23, 1, || bottle(0.033, 0.15, 0.013, 0.07)),
    small("SoapBottle", 0.4, soap_bottle),
    small("Mug", 0.35, mug),
    small("Cup", 0.2, || lathe(&[(0.030, 0.0), (0.041, 0.11)], 12, 1.0)),
    small("DishSponge", 0.05, || block(0.11, 0.03, 0.07)),
    small("Fork", 0.05, || cutlery(0.07, 0.024, 0.12, 0.012)),
    small("Spoon", 0.05, || cutlery(0.06, 0.034, 0.12, 0.012)),
    small("ButterKnife", 0.06, || cutlery(0.10, 0.019, 0.10, 0.014)),
    small("Potato", 0.2, || lathe(&[(0.015, 0.0), (0.030, 0.016), (0.032, 0.034), (0.018, 0.055)], 8, 1.45)),
    small("Apple", 0.2, || lathe(&[(0.018, 0.0), (0.036, 0.022), (0.038, 0.045), (0.02, 0.073)], 8, 1.0)),
    small("Tomato", 0.12, || lathe(&[(0.018, 0.0), (0.035, 0.018), (0.036, 0.036), (0.018, 0.058)], 8, 1.0)),
    small("Egg", 0.06, || lathe(&[(0.010, 0.0), (0.021, 0.014), (0.020, 0.032), (0.008, 0.052)], 8, 1.0)),
    small("SaltShaker", 0.12, || upright(0.022, 0.09)),
    small("PepperShaker", 0.12, || upright(0.022, 0.10)),
    some("CellPhone", 0.18, 0.13, 1, || block(0.15, 0.01, 0.072)),
    some("Statue", 1.5, 0.13, 1, || block(0.10, 0.05, 0.10).with(cylinder(0.035, 0.18), 0.0, 0.14, 0.0)),
    some("SprayBottle", 0.5, 0.07, 1, || bottle(0.04, 0.17, 0.02, 0.08)),
    some("AluminumFoil", 0.4, 0.03, 1, || block(0.31, 0.05, 0.05)),
    some("CreditCard", 0.02, 0.1, 1, || block(0.086, 0.006, 0.054)),
    some("Pen", 0.02, 0.07, 1, || block(0.14, 0.010, 0.010)),
    some("Pencil", 0.02, 0.07, 1, || block(0.18, 0.008, 0.008)),
];

/// A turned thing's foot stands out below it this far, metres.
const FOOT_M: f32 = 0.002;

fn cuboid(x_m: f32, y_m: f32, z_m: f32) -> Primitive {
    Primitive::Cuboid { half_extents_m: 0.5 * Vec3::new(x_m, y_m, z_m) }
}

fn cylinder(radius_m: f32, height_m: f32) -> Primitive {
    Primitive::Cylinder { radius_m, half_height_m: 0.5 * height_m }
}

/// A box of this size.
fn block(x_m: f32, y_m: f32, z_m: f32) -> Shape {
    Shape::default().with(cuboid(x_m, y_m, z_m), 0.0, 0.5 * y_m, 0.0)
}

fn upright(radius_m: f32, height_m: f32) -> Shape {
    Shape::default().with(cylinder(radius_m, height_m), 0.0, 0.5 * height_m, 0.0)
}

fn bottle(radius_m: f32, height_m: f32, neck_radius_m: f32, neck_m: f32) -> Shape {
    upright(radius_m, height_m).with(cylinder(neck_radius_m, neck_m), 0.0, height_m + 0.5 * neck_m, 0.0)
}

/// Convex hull of rings (radius, height) about the y axis, stretched along x, on a low round foot. The foot bears: a
/// hull's underside is several triangles to the contact solver, which then rocks on one of them.
fn lathe(rings: &[(f32, f32)], sides: u32, stretch_x: f32) -> Shape {
    let points_m = rings
        .iter()
        .flat_map(|&(radius, height)| {
            (0..sides).map(move |side| {
                let (sin, cos) = libm::sincosf(2.0 * PI * side as f32 / sides as f32);
                Vec3::new(stretch_x * radius * cos, height, radius * sin)
            })
        })
        .collect();
    let (foot_m, _) = rings[0];
    Shape::of(Primitive::Hull { points_m }).with(cylinder(foot_m, 2.0 * FOOT_M), 0.0, 0.0, 0.0)
}

/// A ball-like hull with a flat underside.
fn globe(radius_m: f32, height_m: f32) -> Shape {
    let rings = [(0.45, 0.0), (0.9, 0.25), (1.0, 0.55), (0.55, 1.0)].map(|(r, h)| (r * radius_m, h * height_m));
    lathe(&rings, 10, 1.0)
}

/// Lies flat: a blade (or head) along +x and a handle along -x.
fn cutlery(head_m: f32, head_width_m: f32, handle_m: f32, handle_width_m: f32) -> Shape {
    Shape::default().with(cuboid(head_m, 0.008, head_width_m), 0.5 * head_m, 0.004, 0.0).with(
        cuboid(handle_m, 0.012, handle_width_m),
        -0.5 * handle_m,
        0.006,
        0.0,
    )
}

fn spatula() -> Shape {
    cutlery(0.09, 0.075, 0.22, 0.02)
}

fn ladle() -> Shape {
    lathe(&[(0.025, 0.0), (0.042, 0.035)], 10, 1.0).with(cuboid(0.24, 0.012, 0.016), 0.16, 0.029, 0.0).with(
        cuboid(0.012, 0.023, 0.016),
        0.27,
        0.0115,
        0.0,
    )
}

fn mug() -> Shape {
    upright(0.04, 0.095)
        .with(cuboid(0.028, 0.010, 0.012), 0.052, 0.075, 0.0)
        .with(cuboid(0.028, 0.010, 0.012), 0.052, 0.022, 0.0)
        .with(cuboid(0.010, 0.063, 0.012), 0.067, 0.0485, 0.0)
}

fn pot() -> Shape {
    upright(0.11, 0.13).with(cuboid(0.04, 0.012, 0.07), 0.125, 0.10, 0.0).with(
        cuboid(0.04, 0.012, 0.07),
        -0.125,
        0.10,
        0.0,
    )
}

fn pan() -> Shape {
    upright(0.125, 0.045).with(cuboid(0.18, 0.016, 0.024), 0.21, 0.033, 0.0)
}

fn plate() -> Shape {
    lathe(&[(0.07, 0.0), (0.115, 0.018), (0.115, 0.022)], 14, 1.0)
}

fn soap_bottle() -> Shape {
    bottle(0.033, 0.15, 0.012, 0.05).with(cuboid(0.05, 0.012, 0.014), 0.015, 0.206, 0.0)
}

fn bread() -> Shape {
    let profile = [(-0.05, 0.0), (0.05, 0.0), (0.057, 0.07), (-0.057, 0.07), (0.03, 0.105), (-0.03, 0.105)];
    let points_m = profile.iter().flat_map(|&(z, y)| [-0.12, 0.12].map(|x| Vec3::new(x, y, z))).collect();
    Shape::of(Primitive::Hull { points_m })
}

fn kettle() -> Shape {
    lathe(&[(0.085, 0.0), (0.085, 0.05), (0.05, 0.16)], 12, 1.0)
        .with(cuboid(0.012, 0.05, 0.016), 0.045, 0.185, 0.0)
        .with(cuboid(0.012, 0.05, 0.016), -0.045, 0.185, 0.0)
        .with(cuboid(0.102, 0.014, 0.02), 0.0, 0.215, 0.0)
        .with(cuboid(0.05, 0.02, 0.024), 0.085, 0.12, 0.0)
}

fn toaster() -> Shape {
    block(0.28, 0.19, 0.17).with(cuboid(0.02, 0.02, 0.04), 0.15, 0.13, 0.0)
}

fn coffee_machine() -> Shape {
    block(0.19, 0.03, 0.27)
        .with(cuboid(0.19, 0.29, 0.10), 0.0, 0.175, 0.085)
        .with(cuboid(0.19, 0.07, 0.17), 0.0, 0.285, -0.05)
        .with(cylinder(0.055, 0.12), 0.0, 0.09, -0.05)
}

fn house_plant() -> Shape {
    let mut plant = lathe(&[(0.06, 0.0), (0.08, 0.13)], 10, 1.0);
    let leaves = lathe(&[(0.05, 0.0), (0.12, 0.08), (0.10, 0.17), (0.03, 0.24)], 8, 1.0);
    plant.parts.extend(leaves.parts.into_iter().map(|mut part| {
        part.body_from_part.translation.y += 0.13;
        part
    }));
    plant
}

fn chair() -> Shape {
    let leg = || cuboid(0.035, 0.44, 0.035);
    Shape::default()
        .with(leg(), 0.18, 0.22, 0.18)
        .with(leg(), -0.18, 0.22, 0.18)
        .with(leg(), 0.18, 0.22, -0.18)
        .with(leg(), -0.18, 0.22, -0.18)
        .with(cuboid(0.41, 0.03, 0.41), 0.0, 0.455, 0.0)
        .with(cuboid(0.39, 0.42, 0.025), 0.0, 0.68, -0.19)
}

fn stool() -> Shape {
    let leg = || cuboid(0.03, 0.62, 0.03);
    Shape::default()
        .with(leg(), 0.13, 0.31, 0.13)
        .with(leg(), -0.13, 0.31, 0.13)
        .with(leg(), 0.13, 0.31, -0.13)
        .with(leg(), -0.13, 0.31, -0.13)
        .with(cylinder(0.17, 0.03), 0.0, 0.635, 0.0)
}

fn garbage_can() -> Shape {
    lathe(&[(0.12, 0.0), (0.15, 0.48)], 12, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::physics::geometry::Solid;
    use proto::kitchen::TargetCategory;
    use rapier3d::math::Pose3;

    #[test]
    fn every_target_is_in_every_kitchen_and_can_be_moved() {
        for target in TargetCategory::ALL {
            let category = CATEGORIES.iter().find(|category| category.name == target.name()).unwrap();
            assert!(category.share >= 1.0 && category.most == 1);
        }
        assert!(CATEGORIES.iter().all(|category| category.mass_kg > 0.0 && category.mass_kg <= 10.0));
    }

    #[test]
    fn shapes_are_centred_and_of_household_size() {
        for category in &CATEGORIES {
            let aabb = Solid::of(&category.shape()).aabb(&Pose3::identity());
            assert!(aabb.center().length() < 1e-5, "{}", category.name);
            assert!(aabb.extents().min_element() > 0.004 && aabb.extents().max_element() < 1.0, "{}", category.name);
        }
    }
}
