use super::category::Material::{Metal, Plastic, Wood};
use super::category::Place::{Floor, Seat};
use super::category::{Category, Material, thing};
use super::colour::{BLACK, CREAM, DARK_WOOD, GREY, RED, STEEL, WHITE, WICKER, WOOD};
use super::forms::{basin, block, cuboid, cylinder, lathe, legs, open_box, spun, upright};
use crate::shape::Shape;

pub const FURNITURE: &[Category] = &[
    thing("Chair", 5.5, Wood, WOOD, Seat, chair).some(12, 1.67),
    thing("Stool", 4.0, Wood, DARK_WOOD, Seat, stool).some(14, 1.36),
    thing("GarbageCan", 1.8, Plastic, GREY, Floor, garbage_can).every(),
    thing("GarbageBag", 1.5, Plastic, BLACK, Floor, garbage_bag).some(3, 1.0),
    thing("BarStool", 6.0, Metal, BLACK, Floor, bar_stool),
    thing("StepStool", 2.2, Plastic, WHITE, Floor, step_stool),
    thing("FoldingChair", 4.2, Metal, STEEL, Floor, folding_chair),
    thing("Bench", 8.5, Wood, WOOD, Floor, bench),
    thing("HighChair", 6.5, Wood, CREAM, Floor, high_chair),
    thing("PedalBin", 2.6, Metal, STEEL, Floor, pedal_bin),
    thing("RecyclingBox", 1.4, Plastic, [64, 120, 78], Floor, || open_box(0.40, 0.28, 0.30, 0.008)),
    thing("LaundryBasket", 1.7, Wood, WICKER, Floor, laundry_basket),
    thing("BottleCrate", 6.0, Plastic, RED, Floor, bottle_crate),
    thing("VegetableCrate", 1.8, Wood, WOOD, Floor, || open_box(0.42, 0.20, 0.30, 0.012)),
    thing("Bucket", 0.7, Plastic, [70, 112, 172], Floor, || basin(0.105, 0.145, 0.27, 0.006, 8)),
    thing("PetBowl", 0.4, Material::Rubber, STEEL, Floor, || {
        lathe(&[(0.10, 0.0), (0.085, 0.05)]).with(cylinder(0.07, 0.01), 0.0, 0.05, 0.0)
    }),
    thing("FloorLantern", 2.4, Metal, BLACK, Floor, lantern),
];

fn chair() -> Shape {
    legs(0.035, 0.44, 0.18, 0.18)
        .with(cuboid(0.41, 0.03, 0.41), 0.0, 0.455, 0.0)
        .with(cuboid(0.03, 0.44, 0.025), 0.18, 0.69, -0.19)
        .with(cuboid(0.03, 0.44, 0.025), -0.18, 0.69, -0.19)
        .with(cuboid(0.34, 0.10, 0.018), 0.0, 0.85, -0.19)
        .with(cuboid(0.34, 0.06, 0.018), 0.0, 0.68, -0.19)
}

fn stool() -> Shape {
    legs(0.03, 0.62, 0.13, 0.13)
        .with(cuboid(0.02, 0.02, 0.26), 0.13, 0.20, 0.0)
        .with(cuboid(0.02, 0.02, 0.26), -0.13, 0.20, 0.0)
        .with(cylinder(0.17, 0.03), 0.0, 0.635, 0.0)
}

fn bar_stool() -> Shape {
    upright(0.20, 0.015).with(cylinder(0.025, 0.68), 0.0, 0.355, 0.0).with(cylinder(0.13, 0.015), 0.0, 0.28, 0.0).with(
        cylinder(0.175, 0.06),
        0.0,
        0.72,
        0.0,
    )
}

fn step_stool() -> Shape {
    block(0.40, 0.03, 0.22).joined(legs(0.04, 0.23, 0.17, 0.09), 0.0, 0.0, 0.0).with(
        cuboid(0.42, 0.025, 0.24),
        0.0,
        0.24,
        0.0,
    )
}

fn folding_chair() -> Shape {
    let rail = |x: f32| {
        Shape::default()
            .with(cuboid(0.022, 0.022, 0.42), x, 0.011, 0.0)
            .with(cuboid(0.022, 0.44, 0.022), x, 0.23, 0.17)
            .with(cuboid(0.022, 0.80, 0.022), x, 0.41, -0.19)
    };
    rail(0.20).joined(rail(-0.20), 0.0, 0.0, 0.0).with(cuboid(0.38, 0.02, 0.38), 0.0, 0.45, 0.0).with(
        cuboid(0.40, 0.16, 0.018),
        0.0,
        0.73,
        -0.19,
    )
}

fn bench() -> Shape {
    legs(0.05, 0.41, 0.44, 0.13).with(cuboid(0.98, 0.035, 0.34), 0.0, 0.427, 0.0).with(
        cuboid(0.84, 0.06, 0.025),
        0.0,
        0.36,
        0.0,
    )
}

fn high_chair() -> Shape {
    legs(0.035, 0.52, 0.20, 0.20)
        .with(cuboid(0.42, 0.03, 0.42), 0.0, 0.535, 0.0)
        .with(cuboid(0.40, 0.34, 0.025), 0.0, 0.72, -0.195)
        .with(cuboid(0.025, 0.16, 0.36), 0.195, 0.63, 0.0)
        .with(cuboid(0.025, 0.16, 0.36), -0.195, 0.63, 0.0)
        .with(cuboid(0.42, 0.02, 0.20), 0.0, 0.72, 0.16)
}

fn garbage_can() -> Shape {
    lathe(&[(0.12, 0.0), (0.15, 0.44)]).with(cylinder(0.155, 0.03), 0.0, 0.455, 0.0).with(
        spun(&[(0.15, 0.0), (0.06, 0.04)], 1.0),
        0.0,
        0.47,
        0.0,
    )
}

fn garbage_bag() -> Shape {
    lathe(&[(0.12, 0.0), (0.17, 0.05), (0.18, 0.18), (0.13, 0.30), (0.04, 0.37)]).with(
        spun(&[(0.03, 0.0), (0.06, 0.07)], 1.0),
        0.0,
        0.36,
        0.0,
    )
}

fn pedal_bin() -> Shape {
    upright(0.145, 0.04)
        .with(cylinder(0.135, 0.54), 0.0, 0.31, 0.0)
        .with(spun(&[(0.14, 0.0), (0.14, 0.02), (0.09, 0.055)], 1.0), 0.0, 0.58, 0.0)
        .with(cuboid(0.09, 0.012, 0.06), 0.0, 0.024, 0.165)
}

fn laundry_basket() -> Shape {
    lathe(&[(0.18, 0.0), (0.21, 0.48)]).with(cylinder(0.22, 0.04), 0.0, 0.50, 0.0).with(
        cylinder(0.03, 0.03),
        0.0,
        0.535,
        0.0,
    )
}

fn bottle_crate() -> Shape {
    open_box(0.40, 0.27, 0.30, 0.012)
        .with(cuboid(0.376, 0.18, 0.008), 0.0, 0.10, 0.0)
        .with(cuboid(0.008, 0.18, 0.276), 0.065, 0.10, 0.0)
        .with(cuboid(0.008, 0.18, 0.276), -0.065, 0.10, 0.0)
}

fn lantern() -> Shape {
    block(0.20, 0.03, 0.20)
        .joined(legs(0.018, 0.30, 0.085, 0.085), 0.0, 0.03, 0.0)
        .with(cylinder(0.035, 0.14), 0.0, 0.10, 0.0)
        .with(spun(&[(0.14, 0.0), (0.03, 0.08)], 1.0), 0.0, 0.33, 0.0)
        .with(cylinder(0.012, 0.03), 0.0, 0.42, 0.0)
}
