use super::category::Material::{Ceramic, Metal, Rubber};
use super::category::Place::{Counter, Stove};
use super::category::{Category, thing};
use super::colour::{BLACK, CREAM, GREY, IRON, ORANGE, RED, STEEL};
use super::forms::{
    along_x, along_z, basin, capsule, cuboid, cylinder, handle, lathe, open_box, oval, rolled, spun, upright,
};
use crate::shape::Shape;

pub const COOKWARE: &[Category] = &[
    thing("Pan", 1.0, Metal, BLACK, Stove, || pan(0.115, 0.125, 0.048, 0.18)).every(),
    thing("Pot", 1.4, Metal, STEEL, Stove, pot).every(),
    thing("Saucepan", 0.9, Metal, STEEL, Stove, saucepan),
    thing("CastIronSkillet", 2.3, Metal, IRON, Stove, || pan(0.12, 0.13, 0.045, 0.12)),
    thing("CrepePan", 0.9, Metal, BLACK, Stove, crepe_pan),
    thing("Wok", 1.6, Metal, IRON, Stove, wok),
    thing("StockPot", 2.4, Metal, STEEL, Stove, || lidded(0.13, 0.22)),
    thing("PressureCooker", 3.2, Metal, STEEL, Stove, pressure_cooker),
    thing("DutchOven", 4.8, Metal, RED, Stove, || lidded(0.13, 0.12)),
    thing("Casserole", 2.1, Ceramic, ORANGE, Counter, casserole),
    thing("Steamer", 1.1, Metal, STEEL, Stove, steamer),
    thing("MokaPot", 0.6, Metal, STEEL, Stove, moka_pot),
    thing("FrenchPress", 0.7, Metal, STEEL, Counter, french_press),
    thing("TeaKettle", 1.3, Metal, RED, Stove, tea_kettle),
    thing("PotLid", 0.5, Metal, STEEL, Counter, pot_lid),
    thing("BakingTray", 0.9, Metal, GREY, Counter, || open_box(0.40, 0.022, 0.30, 0.005)),
    thing("RoastingPan", 1.7, Metal, STEEL, Counter, roasting_pan),
    thing("LoafPan", 0.4, Metal, GREY, Counter, || open_box(0.25, 0.065, 0.11, 0.005)),
    thing("CakePan", 0.5, Metal, GREY, Counter, || basin(0.115, 0.118, 0.065, 0.006, 8)),
    thing("Pie", 1.3, Ceramic, ORANGE, Counter, pie),
    thing("MuffinTin", 0.5, Metal, GREY, Counter, muffin_tin),
    thing("GratinDish", 1.2, Ceramic, CREAM, Counter, gratin_dish),
    thing("SiliconeMould", 0.2, Rubber, RED, Counter, || lathe(&[(0.115, 0.0), (0.115, 0.008), (0.095, 0.07)])),
];

/// A frying pan with a sloping side and a long handle that rises a little.
fn pan(low_m: f32, high_m: f32, height_m: f32, handle_m: f32) -> Shape {
    basin(low_m, high_m, height_m, 0.006, 10).turned(
        capsule(0.011, handle_m + 0.022),
        rolled(high_m + 0.5 * handle_m, height_m.max(0.03) - 0.010, 0.0, 1.66),
    )
}

/// Handles on both sides: a lug and its rounded edge.
fn ears(x_m: f32, y_m: f32) -> Shape {
    [1.0, -1.0].into_iter().fold(Shape::default(), |shape, side| {
        shape
            .with(cuboid(0.030, 0.008, 0.060), side * (x_m + 0.013), y_m, 0.0)
            .turned(capsule(0.007, 0.076), along_z(side * (x_m + 0.028), y_m, 0.0))
    })
}

fn lid(radius_m: f32) -> Shape {
    Shape::default()
        .with(
            spun(&[(radius_m, 0.0), (radius_m, 0.005), (0.6 * radius_m, 0.018), (0.15 * radius_m, 0.022)], 1.0),
            0.0,
            0.0,
            0.0,
        )
        .with(cylinder(0.008, 0.014), 0.0, 0.027, 0.0)
        .with(cylinder(0.018, 0.010), 0.0, 0.038, 0.0)
}

fn pot() -> Shape {
    upright(0.11, 0.13).with(cylinder(0.114, 0.006), 0.0, 0.128, 0.0).joined(ears(0.11, 0.10), 0.0, 0.0, 0.0).joined(
        lid(0.108),
        0.0,
        0.131,
        0.0,
    )
}

fn lidded(radius_m: f32, height_m: f32) -> Shape {
    upright(radius_m, height_m).joined(ears(radius_m, 0.75 * height_m), 0.0, 0.0, 0.0).joined(
        lid(radius_m + 0.003),
        0.0,
        height_m,
        0.0,
    )
}

fn crepe_pan() -> Shape {
    lathe(&[(0.12, 0.0), (0.13, 0.018)]).turned(capsule(0.011, 0.20), rolled(0.22, 0.026, 0.0, 1.66))
}

fn saucepan() -> Shape {
    upright(0.08, 0.095)
        .with(cylinder(0.083, 0.005), 0.0, 0.0945, 0.0)
        .turned(capsule(0.010, 0.19), rolled(0.165, 0.086, 0.0, 1.66))
}

fn wok() -> Shape {
    let bowl = basin(0.07, 0.16, 0.09, 0.006, 8);
    bowl.turned(capsule(0.012, 0.20), rolled(0.245, 0.10, 0.0, 1.75))
}

fn pressure_cooker() -> Shape {
    upright(0.115, 0.17)
        .joined(lid(0.118), 0.0, 0.17, 0.0)
        .turned(cuboid(0.19, 0.024, 0.032), rolled(0.20, 0.17, 0.0, 0.0))
        .with(cuboid(0.05, 0.02, 0.06), -0.13, 0.15, 0.0)
        .with(cylinder(0.008, 0.03), 0.05, 0.195, 0.0)
}

fn casserole() -> Shape {
    oval(&[(0.085, 0.0), (0.105, 0.02), (0.11, 0.085)], 1.35)
        .with(spun(&[(0.112, 0.0), (0.08, 0.025), (0.02, 0.034)], 1.35), 0.0, 0.085, 0.0)
        .with(cylinder(0.018, 0.016), 0.0, 0.125, 0.0)
        .with(cuboid(0.035, 0.014, 0.07), 0.158, 0.075, 0.0)
        .with(cuboid(0.035, 0.014, 0.07), -0.158, 0.075, 0.0)
}

fn steamer() -> Shape {
    upright(0.10, 0.10)
        .with(cylinder(0.104, 0.07), 0.0, 0.137, 0.0)
        .joined(lid(0.104), 0.0, 0.172, 0.0)
        .turned(capsule(0.009, 0.05), along_z(0.115, 0.08, 0.0))
        .turned(capsule(0.009, 0.05), along_z(-0.115, 0.08, 0.0))
}

fn moka_pot() -> Shape {
    lathe(&[(0.048, 0.0), (0.038, 0.075)])
        .with(spun(&[(0.036, 0.0), (0.046, 0.08)], 1.0), 0.0, 0.075, 0.0)
        .with(spun(&[(0.046, 0.0), (0.012, 0.02)], 1.0), 0.0, 0.155, 0.0)
        .with(cylinder(0.008, 0.016), 0.0, 0.182, 0.0)
        .joined(handle(0.036, 0.115, 0.04, 0.07, 0.010), 0.0, 0.0, 0.0)
        .turned(cuboid(0.03, 0.03, 0.018), rolled(-0.046, 0.14, 0.0, -0.5))
}

fn french_press() -> Shape {
    upright(0.052, 0.012)
        .with(cylinder(0.048, 0.17), 0.0, 0.095, 0.0)
        .with(spun(&[(0.052, 0.0), (0.052, 0.008), (0.02, 0.022)], 1.0), 0.0, 0.178, 0.0)
        .with(cylinder(0.003, 0.05), 0.0, 0.22, 0.0)
        .with(super::forms::ball(0.013), 0.0, 0.25, 0.0)
        .joined(handle(0.048, 0.10, 0.04, 0.12, 0.011), 0.0, 0.0, 0.0)
}

fn tea_kettle() -> Shape {
    lathe(&[(0.09, 0.0), (0.105, 0.02), (0.10, 0.07), (0.06, 0.12)])
        .joined(lid(0.05), 0.0, 0.12, 0.0)
        .turned(spun(&[(0.018, -0.04), (0.010, 0.04)], 1.0), rolled(0.11, 0.085, 0.0, -0.8))
        .turned(cuboid(0.014, 0.10, 0.02), rolled(0.065, 0.155, 0.0, 0.25))
        .turned(cuboid(0.014, 0.10, 0.02), rolled(-0.065, 0.155, 0.0, -0.25))
        .turned(capsule(0.011, 0.13), along_x(0.0, 0.205, 0.0))
}

fn pot_lid() -> Shape {
    upright(0.105, 0.006).joined(lid(0.11), 0.0, 0.004, 0.0)
}

fn roasting_pan() -> Shape {
    open_box(0.38, 0.075, 0.27, 0.006)
        .turned(capsule(0.008, 0.12), along_z(0.20, 0.07, 0.0))
        .turned(capsule(0.008, 0.12), along_z(-0.20, 0.07, 0.0))
}

fn pie() -> Shape {
    lathe(&[(0.10, 0.0), (0.135, 0.042)]).with(
        spun(&[(0.135, 0.0), (0.125, 0.010), (0.06, 0.020)], 1.0),
        0.0,
        0.042,
        0.0,
    )
}

fn muffin_tin() -> Shape {
    let cups = (0..6).fold(Shape::default(), |shape, cup| {
        let (column, row) = ((cup % 3) as f32, (cup / 3) as f32);
        shape.with(cylinder(0.033, 0.03), 0.085 * (column - 1.0), 0.015, 0.085 * (row - 0.5))
    });
    cups.with(cuboid(0.27, 0.006, 0.18), 0.0, 0.033, 0.0)
}

fn gratin_dish() -> Shape {
    open_box(0.28, 0.055, 0.19, 0.010).with(cuboid(0.03, 0.012, 0.08), 0.152, 0.048, 0.0).with(
        cuboid(0.03, 0.012, 0.08),
        -0.152,
        0.048,
        0.0,
    )
}
