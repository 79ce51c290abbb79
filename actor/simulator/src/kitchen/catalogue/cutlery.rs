//! What one eats and carves with, lying flat: heads and blades along +x, handles along -x.

use super::category::Material::{Metal, Wood};
use super::category::Place::{Counter, Surface, Table};
use super::category::{Category, thing};
use super::colour::{DARK_WOOD, STEEL, WOOD};
use super::forms::{block, cuboid, cylinder, oval, prism};
use crate::shape::Shape;
use rapier3d::math::{Pose3, Vec3};
use std::f32::consts::PI;

pub const CUTLERY: &[Category] = &[
    thing("Knife", 0.15, Metal, STEEL, Surface, || knife(0.18, 0.034, 0.11, 0.020)).every(),
    thing("Fork", 0.05, Metal, STEEL, Surface, || fork(0.055, 0.024, 0.12, 4)).every(),
    thing("Spoon", 0.05, Metal, STEEL, Surface, || spoon(0.021, 1.5, 0.014, 0.125)).every(),
    thing("ButterKnife", 0.06, Metal, STEEL, Surface, || knife(0.10, 0.019, 0.10, 0.014)).every(),
    thing("Teaspoon", 0.025, Metal, STEEL, Table, || spoon(0.015, 1.5, 0.010, 0.09)),
    thing("SoupSpoon", 0.06, Metal, STEEL, Table, || spoon(0.024, 1.15, 0.015, 0.12)),
    thing("DessertFork", 0.03, Metal, STEEL, Table, || fork(0.042, 0.020, 0.09, 3)),
    thing("CarvingFork", 0.12, Metal, STEEL, Counter, || fork(0.11, 0.026, 0.13, 2)),
    thing("SteakKnife", 0.07, Metal, DARK_WOOD, Table, || knife(0.11, 0.018, 0.10, 0.018)),
    thing("BreadKnife", 0.16, Metal, DARK_WOOD, Counter, || knife(0.21, 0.030, 0.12, 0.024)),
    thing("ParingKnife", 0.06, Metal, STEEL, Counter, || knife(0.08, 0.020, 0.09, 0.018)),
    thing("Cleaver", 0.45, Metal, STEEL, Counter, cleaver),
    thing("CakeServer", 0.09, Metal, STEEL, Table, cake_server),
    thing("Chopsticks", 0.025, Wood, WOOD, Table, chopsticks),
];

/// A handle of this length and width, from x = 0 backwards.
fn grip(length_m: f32, width_m: f32) -> Shape {
    Shape::default().with(cuboid(length_m, 0.012, width_m), -0.5 * length_m, 0.006, 0.0).with(
        cylinder(0.5 * width_m, 0.012),
        -length_m,
        0.006,
        0.0,
    )
}

/// The back three quarters of a blade bear; its point, a hull, is clear of the ground.
fn knife(blade_m: f32, blade_width_m: f32, handle_m: f32, handle_width_m: f32) -> Shape {
    let (straight_m, half_m) = (0.72 * blade_m, 0.5 * blade_width_m);
    // Drawn in the x-y plane and laid down: y becomes z.
    let point = prism(&[(straight_m, -half_m), (straight_m, half_m), (blade_m, half_m)], 0.004);
    let laid = Pose3::from_parts(Vec3::new(0.0, 0.004, 0.0), crate::physics::geometry::rotation_x(0.5 * PI));
    grip(handle_m, handle_width_m)
        .with(cuboid(straight_m, 0.006, blade_width_m), 0.5 * straight_m, 0.003, 0.0)
        .turned(point, laid)
}

fn fork(head_m: f32, width_m: f32, handle_m: f32, tines: u32) -> Shape {
    let (palm_m, tine_m) = (0.35 * head_m, 0.65 * head_m);
    let pitch_m = width_m / (tines as f32 - 0.5);
    let palm = cuboid(palm_m, 0.008, width_m);
    (0..tines).fold(grip(handle_m, 0.014).with(palm, 0.5 * palm_m, 0.004, 0.0), |shape, tine| {
        let z_m = (tine as f32 - 0.5 * (tines - 1) as f32) * pitch_m;
        shape.with(cuboid(tine_m, 0.006, 0.5 * pitch_m), palm_m + 0.5 * tine_m, 0.004, z_m)
    })
}

fn spoon(radius_m: f32, stretch: f32, height_m: f32, handle_m: f32) -> Shape {
    let bowl = oval(&[(0.5 * radius_m, 0.0), (0.85 * radius_m, 0.45 * height_m), (radius_m, height_m)], stretch);
    grip(handle_m, 0.013).joined(bowl, stretch * radius_m - 0.006, 0.002, 0.0)
}

fn cleaver() -> Shape {
    grip(0.12, 0.028).with(cuboid(0.18, 0.008, 0.085), 0.09, 0.004, 0.02)
}

fn cake_server() -> Shape {
    let head = prism(&[(0.03, -0.028), (0.03, 0.028), (0.15, 0.004), (0.15, -0.004)], 0.004);
    let laid = Pose3::from_parts(Vec3::new(0.0, 0.005, 0.0), crate::physics::geometry::rotation_x(0.5 * PI));
    grip(0.12, 0.02).with(cuboid(0.10, 0.004, 0.022), 0.05, 0.002, 0.0).turned(head, laid)
}

fn chopsticks() -> Shape {
    block(0.23, 0.008, 0.008).joined(block(0.23, 0.008, 0.008), 0.0, 0.0, 0.016).with(
        cuboid(0.012, 0.010, 0.030),
        0.07,
        0.005,
        0.008,
    )
}
