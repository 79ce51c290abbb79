use super::category::Material::{Plastic, Rubber};
use super::category::Place::{Counter, Shelf};
use super::category::{Category, thing};
use super::colour::{BLACK, CREAM, GREY, RED, STEEL, WHITE};
use super::forms::{along_x, along_z, block, capsule, cuboid, cylinder, handle, lathe, rolled, spun, upright};
use crate::shape::Shape;

/// Appliances of less than 10 kg. They stand on rubber feet.
pub const APPLIANCES: &[Category] = &[
    thing("Toaster", 1.6, Rubber, STEEL, Counter, toaster).every(),
    thing("CoffeeMachine", 3.2, Rubber, BLACK, Counter, coffee_machine).every(),
    thing("Kettle", 1.1, Rubber, STEEL, Counter, kettle).some(15, 1.0),
    thing("Blender", 3.4, Rubber, GREY, Counter, blender),
    thing("StandMixer", 8.5, Rubber, RED, Counter, stand_mixer),
    thing("HandMixer", 1.1, Plastic, WHITE, Counter, hand_mixer),
    thing("ImmersionBlender", 0.8, Plastic, WHITE, Counter, immersion_blender),
    thing("FoodProcessor", 4.5, Rubber, WHITE, Counter, food_processor),
    thing("RiceCooker", 2.6, Rubber, WHITE, Counter, rice_cooker),
    thing("SlowCooker", 4.6, Rubber, BLACK, Counter, slow_cooker),
    thing("AirFryer", 5.0, Rubber, BLACK, Counter, air_fryer),
    thing("WaffleIron", 2.4, Rubber, STEEL, Counter, waffle_iron),
    thing("SandwichToaster", 1.9, Rubber, BLACK, Counter, sandwich_toaster),
    thing("ToasterOven", 6.5, Rubber, STEEL, Counter, toaster_oven),
    thing("EspressoMachine", 8.0, Rubber, STEEL, Counter, espresso_machine),
    thing("CoffeeGrinder", 1.2, Rubber, BLACK, Counter, coffee_grinder),
    thing("CitrusJuicer", 1.3, Rubber, WHITE, Counter, citrus_juicer),
    thing("EggCooker", 0.9, Rubber, CREAM, Counter, egg_cooker),
    thing("MilkFrother", 0.8, Rubber, STEEL, Counter, milk_frother),
    thing("HotPlate", 2.2, Rubber, BLACK, Counter, hot_plate),
    thing("KitchenScale", 0.6, Rubber, WHITE, Counter, kitchen_scale),
    thing("KitchenRadio", 1.3, Rubber, CREAM, Shelf, radio),
];

fn toaster() -> Shape {
    block(0.25, 0.012, 0.14)
        .with(cuboid(0.28, 0.16, 0.17), 0.0, 0.09, 0.0)
        .with(cuboid(0.26, 0.02, 0.055), 0.0, 0.18, 0.048)
        .with(cuboid(0.26, 0.02, 0.040), 0.0, 0.18, 0.0)
        .with(cuboid(0.26, 0.02, 0.055), 0.0, 0.18, -0.048)
        .with(cuboid(0.02, 0.02, 0.04), 0.15, 0.13, 0.0)
        .turned(cylinder(0.012, 0.012), along_x(0.144, 0.06, 0.0))
}

fn coffee_machine() -> Shape {
    block(0.19, 0.03, 0.27)
        .with(cuboid(0.19, 0.29, 0.10), 0.0, 0.175, 0.085)
        .with(cuboid(0.19, 0.07, 0.17), 0.0, 0.285, -0.05)
        .with(spun(&[(0.05, 0.0), (0.062, 0.03), (0.058, 0.08), (0.045, 0.12)], 1.0), 0.0, 0.03, -0.05)
        .joined(handle(0.05, 0.09, 0.03, 0.07, 0.012), 0.0, 0.0, -0.05)
        .with(spun(&[(0.055, 0.0), (0.035, 0.06)], 1.0), 0.0, 0.19, -0.05)
}

fn kettle() -> Shape {
    upright(0.085, 0.022)
        .with(spun(&[(0.080, 0.0), (0.080, 0.04), (0.062, 0.15)], 1.0), 0.0, 0.022, 0.0)
        .with(spun(&[(0.062, 0.0), (0.045, 0.016), (0.012, 0.022)], 1.0), 0.0, 0.172, 0.0)
        .turned(cuboid(0.04, 0.035, 0.024), rolled(-0.075, 0.145, 0.0, -0.5))
        .joined(handle(0.055, 0.11, 0.055, 0.12, 0.018), 0.0, 0.0, 0.0)
}

fn blender() -> Shape {
    lathe(&[(0.095, 0.0), (0.09, 0.06), (0.065, 0.14)])
        .with(spun(&[(0.050, 0.0), (0.070, 0.20)], 1.0), 0.0, 0.14, 0.0)
        .with(cylinder(0.072, 0.03), 0.0, 0.355, 0.0)
        .joined(handle(0.055, 0.25, 0.05, 0.13, 0.016), 0.0, 0.0, 0.0)
        .turned(cylinder(0.02, 0.02), along_z(0.0, 0.05, 0.093))
}

fn stand_mixer() -> Shape {
    block(0.34, 0.045, 0.20)
        .with(cuboid(0.11, 0.22, 0.11), -0.11, 0.15, 0.0)
        .turned(capsule(0.065, 0.36), along_x(0.0, 0.30, 0.0))
        .with(spun(&[(0.05, 0.0), (0.085, 0.04), (0.105, 0.13)], 1.0), 0.065, 0.045, 0.0)
        .with(cylinder(0.02, 0.07), 0.065, 0.205, 0.0)
}

fn hand_mixer() -> Shape {
    block(0.18, 0.075, 0.075)
        .with(cuboid(0.025, 0.04, 0.03), 0.06, 0.095, 0.0)
        .with(cuboid(0.025, 0.04, 0.03), -0.06, 0.095, 0.0)
        .turned(capsule(0.016, 0.18), along_x(0.0, 0.122, 0.0))
}

fn immersion_blender() -> Shape {
    block(0.16, 0.05, 0.05)
        .turned(cylinder(0.028, 0.20), along_x(0.0, 0.030, 0.0))
        .turned(cylinder(0.014, 0.14), along_x(0.17, 0.030, 0.0))
        .turned(spun(&[(0.016, 0.0), (0.030, 0.035)], 1.0), rolled(0.235, 0.031, 0.0, -std::f32::consts::FRAC_PI_2))
}

fn food_processor() -> Shape {
    block(0.22, 0.13, 0.21)
        .with(cylinder(0.092, 0.14), 0.0, 0.20, 0.0)
        .with(cylinder(0.096, 0.02), 0.0, 0.28, 0.0)
        .with(cylinder(0.035, 0.09), 0.03, 0.335, 0.0)
        .joined(handle(0.09, 0.20, 0.04, 0.11, 0.016), 0.0, 0.0, 0.0)
}

fn rice_cooker() -> Shape {
    lathe(&[(0.11, 0.0), (0.13, 0.04), (0.13, 0.17), (0.12, 0.19)])
        .with(spun(&[(0.12, 0.0), (0.09, 0.03), (0.03, 0.04)], 1.0), 0.0, 0.19, 0.0)
        .with(cylinder(0.016, 0.024), 0.0, 0.24, 0.0)
        .with(cuboid(0.05, 0.06, 0.03), 0.0, 0.07, 0.125)
}

fn slow_cooker() -> Shape {
    super::forms::oval(&[(0.12, 0.0), (0.135, 0.03), (0.14, 0.18)], 1.3)
        .with(spun(&[(0.135, 0.0), (0.10, 0.03), (0.03, 0.04)], 1.3), 0.0, 0.18, 0.0)
        .with(cylinder(0.018, 0.03), 0.0, 0.232, 0.0)
        .with(cuboid(0.04, 0.02, 0.08), 0.195, 0.14, 0.0)
        .with(cuboid(0.04, 0.02, 0.08), -0.195, 0.14, 0.0)
}

fn air_fryer() -> Shape {
    lathe(&[(0.12, 0.0), (0.14, 0.05), (0.145, 0.20), (0.12, 0.29), (0.06, 0.315)])
        .with(cuboid(0.17, 0.12, 0.03), 0.0, 0.09, 0.135)
        .with(cuboid(0.03, 0.035, 0.10), 0.0, 0.10, 0.19)
}

fn waffle_iron() -> Shape {
    upright(0.115, 0.045)
        .with(cylinder(0.118, 0.045), 0.0, 0.072, 0.0)
        .with(cuboid(0.11, 0.018, 0.03), 0.16, 0.075, 0.0)
        .with(cuboid(0.05, 0.07, 0.06), -0.125, 0.037, 0.0)
}

fn sandwich_toaster() -> Shape {
    block(0.23, 0.04, 0.21).with(cuboid(0.23, 0.045, 0.21), 0.0, 0.066, 0.0).with(
        cuboid(0.10, 0.02, 0.05),
        0.0,
        0.055,
        0.125,
    )
}

fn toaster_oven() -> Shape {
    block(0.39, 0.02, 0.26)
        .with(cuboid(0.43, 0.23, 0.30), 0.0, 0.135, 0.0)
        .with(cuboid(0.31, 0.18, 0.012), -0.05, 0.135, 0.155)
        .turned(capsule(0.009, 0.28), along_x(-0.05, 0.215, 0.185))
        .with(cuboid(0.02, 0.012, 0.03), 0.07, 0.215, 0.172)
        .with(cuboid(0.02, 0.012, 0.03), -0.17, 0.215, 0.172)
        .turned(cylinder(0.018, 0.02), along_z(0.165, 0.19, 0.16))
        .turned(cylinder(0.018, 0.02), along_z(0.165, 0.13, 0.16))
        .turned(cylinder(0.018, 0.02), along_z(0.165, 0.07, 0.16))
}

fn espresso_machine() -> Shape {
    block(0.26, 0.05, 0.30)
        .with(cuboid(0.26, 0.28, 0.14), 0.0, 0.19, -0.08)
        .with(cuboid(0.26, 0.09, 0.16), 0.0, 0.285, 0.07)
        .with(cylinder(0.032, 0.04), 0.0, 0.22, 0.07)
        .turned(capsule(0.013, 0.13), along_z(0.0, 0.215, 0.155))
        .turned(cylinder(0.006, 0.14), rolled(0.11, 0.18, 0.08, 0.15))
        .turned(cylinder(0.02, 0.02), along_z(-0.08, 0.29, 0.155))
}

fn coffee_grinder() -> Shape {
    upright(0.055, 0.02)
        .with(cylinder(0.045, 0.15), 0.0, 0.09, 0.0)
        .with(spun(&[(0.045, 0.0), (0.06, 0.08)], 1.0), 0.0, 0.16, 0.0)
        .with(cylinder(0.062, 0.012), 0.0, 0.246, 0.0)
}

fn citrus_juicer() -> Shape {
    upright(0.07, 0.10)
        .with(spun(&[(0.065, 0.0), (0.085, 0.05)], 1.0), 0.0, 0.10, 0.0)
        .with(spun(&[(0.032, 0.0), (0.026, 0.02), (0.006, 0.04)], 1.0), 0.0, 0.15, 0.0)
        .with(cuboid(0.04, 0.012, 0.025), 0.09, 0.115, 0.0)
}

fn egg_cooker() -> Shape {
    upright(0.085, 0.05).with(spun(&[(0.08, 0.0), (0.076, 0.04), (0.045, 0.085)], 1.0), 0.0, 0.05, 0.0).with(
        cylinder(0.015, 0.02),
        0.0,
        0.143,
        0.0,
    )
}

fn milk_frother() -> Shape {
    upright(0.06, 0.025)
        .with(cylinder(0.047, 0.14), 0.0, 0.095, 0.0)
        .with(cylinder(0.049, 0.018), 0.0, 0.174, 0.0)
        .joined(handle(0.044, 0.10, 0.035, 0.09, 0.012), 0.0, 0.0, 0.0)
}

fn hot_plate() -> Shape {
    block(0.22, 0.015, 0.22)
        .with(cuboid(0.26, 0.055, 0.26), 0.0, 0.0425, 0.0)
        .with(cylinder(0.09, 0.012), 0.0, 0.076, -0.01)
        .turned(cylinder(0.02, 0.02), along_z(0.0, 0.042, 0.14))
}

fn kitchen_scale() -> Shape {
    block(0.18, 0.018, 0.22).with(cylinder(0.08, 0.01), 0.0, 0.023, -0.02).with(
        cuboid(0.07, 0.004, 0.03),
        0.0,
        0.02,
        0.085,
    )
}

fn radio() -> Shape {
    block(0.24, 0.14, 0.08)
        .turned(cylinder(0.045, 0.008), along_z(-0.06, 0.07, 0.044))
        .turned(cylinder(0.018, 0.014), along_z(0.06, 0.045, 0.047))
        .with(cuboid(0.09, 0.03, 0.006), 0.06, 0.10, 0.043)
        .turned(capsule(0.007, 0.16), along_x(0.0, 0.147, 0.0))
}
