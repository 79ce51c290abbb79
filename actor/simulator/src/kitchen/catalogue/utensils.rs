//! What one cooks with: most of it lies flat, heads along +x, handles along -x.

use super::category::Material::{Metal, Plastic, Rubber, Wood};
use super::category::Place::{Counter, Stove, Surface};
use super::category::{Category, thing};
use super::colour::{BLACK, GREY, RED, STEEL, WHITE, WOOD};
use super::forms::{
    along_x, ball, basin, block, capsule, cuboid, cylinder, handle, lathe, oval, rolled, spun, upright,
};
use crate::shape::{Primitive, Shape};

pub const UTENSILS: &[Category] = &[
    thing("Spatula", 0.1, Plastic, BLACK, Surface, spatula).every(),
    thing("Ladle", 0.15, Metal, STEEL, Surface, || dipper(0.042, 0.036, 0.24)).some(10, 1.1),
    thing("Whisk", 0.12, Metal, STEEL, Counter, whisk),
    thing("RollingPin", 0.6, Wood, WOOD, Counter, rolling_pin),
    thing("CuttingBoard", 1.1, Wood, WOOD, Counter, cutting_board),
    thing("WoodenSpoon", 0.06, Wood, WOOD, Stove, || flat_spoon(0.026, 0.25)),
    thing("SlottedSpoon", 0.1, Metal, STEEL, Stove, || flat_spoon(0.034, 0.24)),
    thing("SauceSpoon", 0.09, Metal, STEEL, Stove, || dipper(0.028, 0.026, 0.20)),
    thing("Tongs", 0.15, Metal, STEEL, Counter, tongs),
    thing("Peeler", 0.06, Plastic, BLACK, Counter, peeler),
    thing("BoxGrater", 0.3, Metal, STEEL, Counter, box_grater),
    thing("CanOpener", 0.2, Metal, BLACK, Counter, can_opener),
    thing("Corkscrew", 0.13, Metal, STEEL, Counter, corkscrew),
    thing("PizzaCutter", 0.15, Metal, STEEL, Counter, pizza_cutter),
    thing("MeasuringCup", 0.35, Plastic, WHITE, Counter, measuring_cup),
    thing("MeasuringSpoon", 0.02, Metal, STEEL, Counter, || dipper(0.016, 0.014, 0.08)),
    thing("Sieve", 0.25, Metal, STEEL, Counter, || dipper(0.085, 0.07, 0.17)),
    thing("Colander", 0.5, Metal, STEEL, Counter, colander),
    thing("RubberScraper", 0.07, Rubber, RED, Counter, scraper),
    thing("PastryBrush", 0.04, Wood, WOOD, Counter, pastry_brush),
    thing("PotatoMasher", 0.25, Metal, STEEL, Counter, potato_masher),
    thing("IceCreamScoop", 0.16, Metal, STEEL, Counter, || dipper(0.025, 0.026, 0.15)),
    thing("MeatMallet", 0.35, Metal, STEEL, Counter, meat_mallet),
    thing("KitchenScissors", 0.12, Metal, BLACK, Counter, scissors),
    thing("GarlicPress", 0.25, Metal, STEEL, Counter, garlic_press),
    thing("Funnel", 0.05, Plastic, WHITE, Counter, funnel),
    thing("Mortar", 1.6, super::category::Material::Ceramic, GREY, Counter, mortar),
    thing("PepperMill", 0.3, Wood, WOOD, Surface, pepper_mill),
    thing("LemonSqueezer", 0.2, Plastic, WHITE, Counter, lemon_squeezer),
    thing("KitchenTimer", 0.1, Plastic, RED, Counter, || {
        lathe(&[(0.024, 0.0), (0.032, 0.02), (0.028, 0.05), (0.012, 0.06)])
    }),
    thing("SpoonRest", 0.2, super::category::Material::Ceramic, WHITE, Stove, spoon_rest),
];

/// A round handle from x = 0 backwards, on a strip that bears.
fn grip(length_m: f32, radius_m: f32) -> Shape {
    let strip_m = 0.8 * radius_m;
    Shape::default()
        .with(cuboid(0.8 * length_m, strip_m, radius_m), -0.5 * length_m, 0.5 * strip_m, 0.0)
        .turned(capsule(radius_m, length_m), along_x(-0.5 * length_m, 1.05 * radius_m, 0.0))
}

fn spatula() -> Shape {
    grip(0.16, 0.009).with(cuboid(0.09, 0.006, 0.016), 0.03, 0.006, 0.0).with(
        cuboid(0.09, 0.006, 0.075),
        0.11,
        0.003,
        0.0,
    )
}

/// A round bowl with a straight handle whose end is propped up at the height of its rim.
fn dipper(radius_m: f32, height_m: f32, handle_m: f32) -> Shape {
    let end_m = -radius_m - handle_m;
    let rod = cuboid(handle_m + 0.3 * radius_m, 0.006, 0.012);
    lathe(&[(0.6 * radius_m, 0.0), (0.88 * radius_m, 0.35 * height_m), (radius_m, height_m)])
        .with(rod, 0.5 * (end_m - 0.7 * radius_m), height_m - 0.005, 0.0)
        // Where such a thing has a hook: what it rests on.
        .with(cuboid(0.010, height_m, 0.016), end_m, 0.5 * height_m - 0.002, 0.0)
}

fn flat_spoon(radius_m: f32, handle_m: f32) -> Shape {
    grip(handle_m, 0.006).joined(
        oval(&[(0.7 * radius_m, 0.0), (radius_m, 0.008), (0.9 * radius_m, 0.013)], 1.4),
        1.3 * radius_m,
        0.002,
        0.0,
    )
}

fn whisk() -> Shape {
    let wires = spun(&[(0.008, 0.0), (0.026, 0.06), (0.028, 0.09), (0.018, 0.12)], 1.0);
    grip(0.14, 0.011).turned(wires, rolled(0.0, 0.028, 0.0, -std::f32::consts::FRAC_PI_2)).with(
        cuboid(0.05, 0.014, 0.02),
        0.08,
        0.007,
        0.0,
    )
}

fn rolling_pin() -> Shape {
    block(0.20, 0.012, 0.030)
        .turned(cylinder(0.027, 0.25), along_x(0.0, 0.028, 0.0))
        .turned(capsule(0.012, 0.10), along_x(0.165, 0.028, 0.0))
        .turned(capsule(0.012, 0.10), along_x(-0.165, 0.028, 0.0))
}

fn cutting_board() -> Shape {
    block(0.34, 0.02, 0.23).with(cuboid(0.09, 0.02, 0.07), 0.21, 0.01, 0.0).with(
        cylinder(0.035, 0.02),
        0.255,
        0.01,
        0.0,
    )
}

fn tongs() -> Shape {
    let arm = || super::forms::block(0.24, 0.012, 0.020);
    let head = cuboid(0.05, 0.012, 0.034);
    Shape::default()
        .joined(arm(), 0.0, 0.0, 0.022)
        .joined(arm(), 0.0, 0.0, -0.022)
        .with(cuboid(0.02, 0.012, 0.060), -0.12, 0.006, 0.0)
        .with(head.clone(), 0.14, 0.006, 0.024)
        .with(head, 0.14, 0.006, -0.024)
}

fn peeler() -> Shape {
    grip(0.10, 0.009)
        .with(cuboid(0.06, 0.010, 0.005), 0.03, 0.005, 0.018)
        .with(cuboid(0.06, 0.010, 0.005), 0.03, 0.005, -0.018)
        .with(cuboid(0.012, 0.004, 0.036), 0.05, 0.007, 0.0)
        .with(cuboid(0.012, 0.010, 0.036), 0.0, 0.005, 0.0)
}

fn box_grater() -> Shape {
    let body: Vec<_> = [(0.0, 0.055, 0.045), (0.19, 0.040, 0.030)]
        .into_iter()
        .flat_map(|(y, x, z)| [(x, z), (-x, z), (x, -z), (-x, -z)].map(|(x, z)| rapier3d::math::Vec3::new(x, y, z)))
        .collect();
    block(0.112, 0.012, 0.092)
        .with(Primitive::Hull { points_m: body }, 0.0, 0.004, 0.0)
        .with(cuboid(0.012, 0.03, 0.016), 0.03, 0.205, 0.0)
        .with(cuboid(0.012, 0.03, 0.016), -0.03, 0.205, 0.0)
        .turned(capsule(0.009, 0.09), along_x(0.0, 0.224, 0.0))
}

fn can_opener() -> Shape {
    block(0.16, 0.018, 0.016)
        .joined(block(0.16, 0.018, 0.016), 0.0, 0.0, 0.026)
        .with(cylinder(0.014, 0.03), 0.075, 0.015, 0.012)
        .with(cuboid(0.06, 0.006, 0.014), 0.075, 0.033, 0.012)
}

fn corkscrew() -> Shape {
    block(0.09, 0.022, 0.024)
        .turned(cylinder(0.007, 0.08), along_x(0.08, 0.012, 0.0))
        .with(cuboid(0.10, 0.010, 0.012), -0.02, 0.005, 0.030)
        .with(cuboid(0.10, 0.010, 0.012), -0.02, 0.005, -0.030)
        .with(cuboid(0.012, 0.012, 0.07), 0.03, 0.006, 0.0)
}

fn pizza_cutter() -> Shape {
    grip(0.11, 0.011).with(cylinder(0.034, 0.006), 0.045, 0.005, 0.0).with(cuboid(0.07, 0.008, 0.014), 0.02, 0.009, 0.0)
}

fn measuring_cup() -> Shape {
    lathe(&[(0.050, 0.0), (0.062, 0.13)]).turned(cuboid(0.03, 0.02, 0.025), rolled(-0.062, 0.122, 0.0, -0.5)).joined(
        handle(0.052, 0.07, 0.04, 0.09, 0.011),
        0.0,
        0.0,
        0.0,
    )
}

fn colander() -> Shape {
    basin(0.065, 0.125, 0.11, 0.006, 8).with(cuboid(0.035, 0.008, 0.06), 0.135, 0.103, 0.0).with(
        cuboid(0.035, 0.008, 0.06),
        -0.135,
        0.103,
        0.0,
    )
}

fn scraper() -> Shape {
    grip(0.19, 0.007).with(cuboid(0.085, 0.010, 0.055), 0.04, 0.005, 0.0)
}

fn pastry_brush() -> Shape {
    block(0.14, 0.010, 0.018).with(cuboid(0.03, 0.012, 0.036), 0.08, 0.006, 0.0).with(
        cuboid(0.045, 0.008, 0.040),
        0.115,
        0.004,
        0.0,
    )
}

/// Stands on its head.
fn potato_masher() -> Shape {
    block(0.09, 0.008, 0.075)
        .with(cylinder(0.004, 0.10), 0.032, 0.055, 0.0)
        .with(cylinder(0.004, 0.10), -0.032, 0.055, 0.0)
        .turned(capsule(0.006, 0.076), along_x(0.0, 0.105, 0.0))
        .with(capsule(0.013, 0.13), 0.0, 0.165, 0.0)
}

fn meat_mallet() -> Shape {
    block(0.055, 0.055, 0.08).turned(cylinder(0.011, 0.20), along_x(-0.12, 0.0275, 0.0)).with(
        cuboid(0.012, 0.028, 0.02),
        -0.20,
        0.014,
        0.0,
    )
}

fn scissors() -> Shape {
    let eye = |z: f32| {
        Shape::default().with(cuboid(0.045, 0.010, 0.030), -0.06, 0.005, z).with(
            cylinder(0.017, 0.010),
            -0.085,
            0.005,
            z,
        )
    };
    eye(0.021)
        .joined(eye(-0.021), 0.0, 0.0, 0.0)
        .with(cuboid(0.05, 0.012, 0.022), -0.015, 0.006, 0.0)
        .with(cuboid(0.10, 0.006, 0.010), 0.06, 0.003, 0.005)
        .with(cuboid(0.10, 0.006, 0.010), 0.06, 0.004, -0.004)
}

fn garlic_press() -> Shape {
    block(0.17, 0.014, 0.016).joined(block(0.17, 0.014, 0.016), 0.0, 0.0, 0.028).with(
        cuboid(0.05, 0.03, 0.048),
        0.085,
        0.015,
        0.014,
    )
}

/// Stands on its wide rim.
fn funnel() -> Shape {
    lathe(&[(0.055, 0.0), (0.055, 0.010), (0.012, 0.06)]).with(cylinder(0.009, 0.06), 0.0, 0.088, 0.0)
}

fn mortar() -> Shape {
    basin(0.05, 0.068, 0.085, 0.014, 8)
        .turned(spun(&[(0.018, -0.07), (0.011, 0.07)], 1.0), rolled(0.012, 0.082, 0.0, -0.25))
}

fn pepper_mill() -> Shape {
    lathe(&[(0.029, 0.0), (0.029, 0.05), (0.019, 0.13)])
        .with(spun(&[(0.019, 0.0), (0.027, 0.02), (0.024, 0.04), (0.010, 0.05)], 1.0), 0.0, 0.13, 0.0)
        .with(ball(0.009), 0.0, 0.187, 0.0)
}

fn lemon_squeezer() -> Shape {
    upright(0.055, 0.03).with(spun(&[(0.028, 0.0), (0.022, 0.02), (0.005, 0.04)], 1.0), 0.0, 0.03, 0.0).with(
        cuboid(0.05, 0.010, 0.024),
        0.075,
        0.022,
        0.0,
    )
}

fn spoon_rest() -> Shape {
    lathe(&[(0.038, 0.0), (0.05, 0.012), (0.05, 0.016)]).with(cuboid(0.10, 0.010, 0.04), 0.085, 0.006, 0.0)
}
