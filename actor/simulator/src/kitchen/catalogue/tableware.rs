use super::category::Material::{Ceramic, Glass, Metal, Plastic, Wood};
use super::category::Place::{Shelf, Surface, Table};
use super::category::{Category, thing};
use super::colour::{BLUE, CREAM, DARK_WOOD, GLASS, STEEL, WHITE, WOOD};
use super::forms::{
    basin, block, capsule, cuboid, cylinder, handle, jar, lathe, open_box, oval, rolled, spun, upright,
};
use crate::shape::Shape;

pub const TABLEWARE: &[Category] = &[
    thing("Plate", 0.5, Ceramic, WHITE, Surface, || plate(0.075, 0.125, 0.022)).every(),
    thing("Bowl", 0.4, Ceramic, BLUE, Surface, || basin(0.042, 0.078, 0.065, 0.007, 10)).every(),
    thing("Mug", 0.35, Ceramic, [176, 62, 54], Surface, || mug(0.040, 0.095)).every(),
    thing("Cup", 0.2, Plastic, BLUE, Surface, cup).every(),
    thing("SidePlate", 0.28, Ceramic, WHITE, Table, || plate(0.055, 0.09, 0.018)),
    thing("SoupPlate", 0.45, Ceramic, WHITE, Table, || plate(0.06, 0.115, 0.038)),
    thing("Saucer", 0.17, Ceramic, WHITE, Table, || plate(0.042, 0.072, 0.016)),
    thing("Teacup", 0.2, Ceramic, WHITE, Table, teacup),
    thing("EspressoCup", 0.11, Ceramic, WHITE, Surface, || mug(0.028, 0.055)),
    thing("BeerMug", 0.6, Glass, GLASS, Shelf, || mug(0.042, 0.15)),
    thing("Tumbler", 0.25, Glass, GLASS, Surface, || lathe(&[(0.034, 0.0), (0.041, 0.095)])),
    thing("HighballGlass", 0.3, Glass, GLASS, Surface, || lathe(&[(0.030, 0.0), (0.035, 0.15)])),
    thing("ShotGlass", 0.08, Glass, GLASS, Shelf, || lathe(&[(0.018, 0.0), (0.024, 0.06)])),
    thing("WineGlass", 0.17, Glass, GLASS, Surface, || {
        stemmed(0.036, 0.085, &[(0.010, 0.0), (0.038, 0.04), (0.032, 0.11)])
    }),
    thing("ChampagneFlute", 0.15, Glass, GLASS, Shelf, || {
        stemmed(0.033, 0.09, &[(0.008, 0.0), (0.024, 0.05), (0.022, 0.13)])
    }),
    thing("DessertGlass", 0.2, Glass, GLASS, Shelf, || {
        stemmed(0.036, 0.03, &[(0.012, 0.0), (0.045, 0.03), (0.050, 0.065)])
    }),
    thing("EggCup", 0.07, Ceramic, WHITE, Table, || stemmed(0.023, 0.015, &[(0.012, 0.0), (0.025, 0.035)])),
    thing("Ramekin", 0.2, Ceramic, WHITE, Surface, || {
        upright(0.042, 0.042).with(cylinder(0.046, 0.010), 0.0, 0.044, 0.0)
    }),
    thing("SaladBowl", 0.9, Wood, WOOD, Table, || basin(0.07, 0.13, 0.10, 0.010, 8)),
    thing("MixingBowl", 0.7, Metal, STEEL, Surface, || basin(0.065, 0.125, 0.115, 0.006, 8)),
    thing("FruitBowl", 1.1, Ceramic, CREAM, Table, || basin(0.07, 0.15, 0.085, 0.009, 8)),
    thing("ServingPlatter", 0.9, Ceramic, WHITE, Table, || oval(&[(0.09, 0.0), (0.125, 0.018), (0.125, 0.022)], 1.45)),
    thing("CakeStand", 1.1, Glass, GLASS, Table, cake_stand),
    thing("Tray", 0.8, Wood, DARK_WOOD, Table, tray),
    thing("Pitcher", 0.9, Ceramic, WHITE, Table, pitcher),
    thing("MilkJug", 0.3, Ceramic, WHITE, Table, milk_jug),
    thing("SugarBowl", 0.3, Ceramic, WHITE, Table, sugar_bowl),
    thing("Teapot", 0.9, Ceramic, BLUE, Table, teapot),
    thing("GravyBoat", 0.35, Ceramic, WHITE, Table, gravy_boat),
    thing("ButterDish", 0.5, Ceramic, CREAM, Table, butter_dish),
    thing("ThermosFlask", 0.6, Metal, STEEL, Surface, || jar(0.040, 0.22, 0.034, 0.06)),
    thing("WaterBottle", 0.7, Metal, BLUE, Surface, || super::forms::bottle(0.036, 0.20, 0.020, 0.045)),
    thing("TravelMug", 0.35, Metal, STEEL, Surface, travel_mug),
    thing("Carafe", 0.9, Glass, GLASS, Table, carafe),
];

fn plate(low_m: f32, high_m: f32, height_m: f32) -> Shape {
    let rim = spun(&[(0.92 * low_m, 0.0), (high_m, height_m - 0.004), (high_m, height_m)], 1.0);
    upright(low_m, 0.006).with(rim, 0.0, 0.001, 0.0)
}

fn mug(radius_m: f32, height_m: f32) -> Shape {
    let grip = handle(0.96 * radius_m, 0.5 * height_m, 0.6 * radius_m, 0.62 * height_m, 0.2 * radius_m);
    upright(radius_m, height_m).joined(grip, 0.0, 0.0, 0.0)
}

fn cup() -> Shape {
    lathe(&[(0.030, 0.0), (0.040, 0.105)]).with(cylinder(0.042, 0.006), 0.0, 0.107, 0.0)
}

fn teacup() -> Shape {
    lathe(&[(0.024, 0.0), (0.038, 0.025), (0.045, 0.06)]).joined(
        handle(0.038, 0.036, 0.024, 0.034, 0.007),
        0.0,
        0.0,
        0.0,
    )
}

fn stemmed(foot_m: f32, stem_m: f32, bowl: &[(f32, f32)]) -> Shape {
    upright(foot_m, 0.005).with(cylinder(0.006, stem_m), 0.0, 0.5 * stem_m, 0.0).with(spun(bowl, 1.0), 0.0, stem_m, 0.0)
}

fn cake_stand() -> Shape {
    upright(0.075, 0.012).with(cylinder(0.02, 0.09), 0.0, 0.055, 0.0).with(cylinder(0.145, 0.012), 0.0, 0.104, 0.0)
}

fn tray() -> Shape {
    open_box(0.42, 0.045, 0.30, 0.012)
        .turned(capsule(0.008, 0.12), super::forms::along_z(0.205, 0.058, 0.0))
        .turned(capsule(0.008, 0.12), super::forms::along_z(-0.205, 0.058, 0.0))
}

fn pitcher() -> Shape {
    lathe(&[(0.055, 0.0), (0.068, 0.04), (0.062, 0.13), (0.050, 0.21)])
        .turned(cuboid(0.035, 0.03, 0.03), rolled(-0.052, 0.195, 0.0, -0.6))
        .joined(handle(0.052, 0.12, 0.05, 0.14, 0.014), 0.0, 0.0, 0.0)
}

fn milk_jug() -> Shape {
    lathe(&[(0.030, 0.0), (0.040, 0.03), (0.032, 0.09)])
        .turned(cuboid(0.022, 0.016, 0.018), rolled(-0.034, 0.083, 0.0, -0.6))
        .joined(handle(0.032, 0.05, 0.028, 0.055, 0.008), 0.0, 0.0, 0.0)
}

fn sugar_bowl() -> Shape {
    lathe(&[(0.030, 0.0), (0.046, 0.03), (0.044, 0.065)])
        .with(spun(&[(0.045, 0.0), (0.03, 0.014), (0.010, 0.018)], 1.0), 0.0, 0.066, 0.0)
        .with(super::forms::ball(0.010), 0.0, 0.090, 0.0)
}

fn teapot() -> Shape {
    lathe(&[(0.055, 0.0), (0.082, 0.04), (0.080, 0.08), (0.048, 0.12)])
        .with(spun(&[(0.045, 0.0), (0.030, 0.012), (0.010, 0.016)], 1.0), 0.0, 0.12, 0.0)
        .with(super::forms::ball(0.012), 0.0, 0.145, 0.0)
        .turned(spun(&[(0.020, -0.045), (0.010, 0.045)], 1.0), rolled(-0.105, 0.085, 0.0, 0.8))
        .joined(handle(0.07, 0.07, 0.05, 0.08, 0.012), 0.0, 0.0, 0.0)
}

fn gravy_boat() -> Shape {
    oval(&[(0.03, 0.0), (0.04, 0.03), (0.045, 0.075)], 1.6)
        .turned(cuboid(0.04, 0.02, 0.03), rolled(-0.075, 0.068, 0.0, -0.4))
        .joined(handle(0.06, 0.05, 0.035, 0.05, 0.009), 0.0, 0.0, 0.0)
}

fn butter_dish() -> Shape {
    block(0.19, 0.014, 0.11)
        .with(cuboid(0.155, 0.055, 0.08), 0.0, 0.041, 0.0)
        .turned(capsule(0.008, 0.05), super::forms::along_x(0.0, 0.074, 0.0))
}

fn travel_mug() -> Shape {
    lathe(&[(0.032, 0.0), (0.041, 0.155)]).with(cylinder(0.043, 0.022), 0.0, 0.164, 0.0).with(
        cuboid(0.02, 0.008, 0.016),
        0.025,
        0.178,
        0.0,
    )
}

fn carafe() -> Shape {
    lathe(&[(0.055, 0.0), (0.060, 0.02), (0.056, 0.10), (0.026, 0.18)]).with(
        spun(&[(0.024, 0.0), (0.036, 0.07)], 1.0),
        0.0,
        0.175,
        0.0,
    )
}
