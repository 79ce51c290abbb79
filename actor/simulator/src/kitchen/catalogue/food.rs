use super::category::Material::Food;
use super::category::Place::{Counter, Surface, Table};
use super::category::{Category, thing};
use super::colour::{BROWN, CREAM, DARK_GREEN, GREEN, ORANGE, PINK, PURPLE, RED, WHITE, YELLOW};
use super::forms::{along_x, ball, block, capsule, cuboid, cylinder, fruit, lathe, oval, prism, rolled, spun, upright};
use crate::shape::Shape;
use std::f32::consts::PI;

const PEEL: [u8; 3] = [176, 136, 88];
const CRUST: [u8; 3] = [190, 128, 66];

pub const FOOD: &[Category] = &[
    thing("Bread", 0.7, Food, CRUST, Surface, bread).every(),
    thing("Potato", 0.2, Food, PEEL, Surface, || fruit(0.032, 0.055, 1.45)).every(),
    thing("Tomato", 0.12, Food, RED, Surface, tomato).every(),
    thing("Egg", 0.06, Food, CREAM, Surface, egg).every(),
    thing("Lettuce", 0.5, Food, GREEN, Surface, lettuce).every(),
    thing("Apple", 0.2, Food, [186, 46, 42], Surface, apple).every(),
    thing("Banana", 0.13, Food, YELLOW, Surface, || bananas(1)),
    thing("BananaBunch", 0.5, Food, YELLOW, Surface, || bananas(3)),
    thing("Orange", 0.2, Food, ORANGE, Surface, || fruit(0.039, 0.076, 1.0)),
    thing("Lemon", 0.11, Food, YELLOW, Surface, || fruit(0.027, 0.052, 1.4)),
    thing("Lime", 0.07, Food, GREEN, Surface, || fruit(0.023, 0.045, 1.25)),
    thing("Grapefruit", 0.38, Food, [236, 166, 84], Surface, || fruit(0.055, 0.105, 1.0)),
    thing("Pear", 0.19, Food, [176, 184, 76], Surface, pear),
    thing("Peach", 0.16, Food, [232, 152, 104], Surface, || fruit(0.035, 0.066, 1.0)),
    thing("Mango", 0.35, Food, [220, 140, 60], Surface, || fruit(0.040, 0.076, 1.4)),
    thing("Kiwi", 0.08, Food, BROWN, Surface, || fruit(0.024, 0.046, 1.3)),
    thing("Avocado", 0.2, Food, DARK_GREEN, Surface, || fruit(0.033, 0.062, 1.5)),
    thing("Pineapple", 1.4, Food, [188, 140, 58], Counter, pineapple),
    thing("Melon", 1.5, Food, [212, 190, 116], Counter, || fruit(0.075, 0.145, 1.1)),
    thing("Watermelon", 4.5, Food, DARK_GREEN, Counter, || fruit(0.105, 0.20, 1.25)),
    thing("Pumpkin", 3.2, Food, ORANGE, Counter, pumpkin),
    thing("Onion", 0.16, Food, [190, 128, 72], Surface, onion),
    thing("Garlic", 0.05, Food, WHITE, Surface, garlic),
    thing("Carrot", 0.09, Food, ORANGE, Surface, carrot),
    thing("Cucumber", 0.35, Food, DARK_GREEN, Surface, || log(0.022, 0.28)),
    thing("Zucchini", 0.3, Food, DARK_GREEN, Surface, || log(0.025, 0.21)),
    thing("Eggplant", 0.35, Food, PURPLE, Surface, eggplant),
    thing("BellPepper", 0.18, Food, [206, 60, 40], Surface, bell_pepper),
    thing("Broccoli", 0.4, Food, DARK_GREEN, Counter, broccoli),
    thing("Cauliflower", 0.8, Food, CREAM, Counter, || crowned(0.07, GREENS_M)),
    thing("Cabbage", 1.2, Food, [168, 194, 128], Counter, || fruit(0.085, 0.16, 1.0)),
    thing("Corn", 0.25, Food, YELLOW, Counter, || log(0.024, 0.20)),
    thing("Mushroom", 0.025, Food, CREAM, Counter, mushroom),
    thing("Baguette", 0.3, Food, CRUST, Counter, || loaf(0.58, 0.065, 0.05)),
    thing("BreadRoll", 0.07, Food, CRUST, Table, || fruit(0.04, 0.05, 1.2)),
    thing("Croissant", 0.06, Food, CRUST, Table, croissant),
    thing("Donut", 0.06, Food, PINK, Table, || lathe(&[(0.036, 0.0), (0.044, 0.012), (0.042, 0.026), (0.026, 0.034)])),
    thing("CheeseWedge", 0.3, Food, YELLOW, Counter, cheese),
    thing("Cake", 1.1, Food, [120, 72, 44], Table, cake),
    thing("Sausage", 0.35, Food, [150, 66, 52], Counter, || log(0.026, 0.24)),
];

/// How far leaves reach out below a cauliflower's head, metres.
const GREENS_M: f32 = 0.035;

/// A loaf along x: its foot is a box, its rounded top a hull.
fn loaf(length_m: f32, width_m: f32, height_m: f32) -> Shape {
    let half_m = 0.5 * width_m;
    let top = prism(
        &[
            (-half_m, 0.0),
            (half_m, 0.0),
            (1.06 * half_m, 0.45 * height_m),
            (0.75 * half_m, 0.78 * height_m),
            (0.0, 0.88 * height_m),
            (-0.75 * half_m, 0.78 * height_m),
            (-1.06 * half_m, 0.45 * height_m),
        ],
        length_m,
    );
    block(0.96 * length_m, 0.3 * height_m, 0.95 * width_m)
        .turned(top, super::forms::yawed(0.0, 0.12 * height_m, 0.0, 0.5 * PI))
}

fn bread() -> Shape {
    loaf(0.24, 0.11, 0.105)
}

/// Something long and round that lies along x, on a flat strip.
fn log(radius_m: f32, length_m: f32) -> Shape {
    block(0.7 * length_m, 0.6 * radius_m, 1.1 * radius_m)
        .turned(capsule(radius_m, length_m), along_x(0.0, 1.03 * radius_m, 0.0))
}

fn stalk(radius_m: f32, length_m: f32) -> crate::shape::Primitive {
    cylinder(radius_m, length_m)
}

fn apple() -> Shape {
    fruit(0.038, 0.070, 1.0).with(stalk(0.0025, 0.014), 0.0, 0.074, 0.0)
}

fn tomato() -> Shape {
    fruit(0.036, 0.056, 1.0).with(stalk(0.008, 0.006), 0.0, 0.057, 0.0)
}

/// On its side, as an egg lies.
fn egg() -> Shape {
    oval(&[(0.010, 0.0), (0.018, 0.007), (0.0215, 0.020), (0.018, 0.033), (0.007, 0.041)], 1.3)
}

fn lettuce() -> Shape {
    lathe(&[(0.038, 0.0), (0.068, 0.03), (0.075, 0.07), (0.060, 0.105), (0.028, 0.128)])
        .turned(cylinder(0.062, 0.010), rolled(0.034, 0.075, 0.0, 1.2))
        .turned(cylinder(0.062, 0.010), rolled(-0.034, 0.075, 0.0, -1.2))
}

fn bananas(count: u32) -> Shape {
    const PITCH_M: f32 = 0.034;
    const BEND_RAD: f32 = 0.45;
    let foot = block(0.06, 0.012, 0.022 + PITCH_M * (count - 1) as f32);
    (0..count).fold(foot, |shape, index| {
        let z_m = PITCH_M * (index as f32 - 0.5 * (count - 1) as f32);
        shape
            .turned(capsule(0.017, 0.10), along_x(0.0, 0.019, z_m))
            .turned(capsule(0.0155, 0.09), rolled(0.068, 0.033, z_m, BEND_RAD - 0.5 * PI))
            .turned(capsule(0.0155, 0.09), rolled(-0.068, 0.033, z_m, 0.5 * PI - BEND_RAD))
    })
}

fn pear() -> Shape {
    lathe(&[(0.020, 0.0), (0.036, 0.018), (0.037, 0.040), (0.028, 0.064), (0.014, 0.088)]).with(
        stalk(0.002, 0.02),
        0.0,
        0.096,
        0.0,
    )
}

fn pineapple() -> Shape {
    lathe(&[(0.042, 0.0), (0.058, 0.03), (0.062, 0.09), (0.055, 0.14), (0.035, 0.165)])
        .with(spun(&[(0.022, 0.0), (0.045, 0.06)], 1.0), 0.0, 0.16, 0.0)
        .with(spun(&[(0.026, 0.0), (0.012, 0.10)], 1.0), 0.0, 0.20, 0.0)
}

fn pumpkin() -> Shape {
    fruit(0.12, 0.16, 1.0).with(spun(&[(0.016, 0.0), (0.011, 0.045)], 1.0), 0.0, 0.155, 0.0)
}

fn onion() -> Shape {
    fruit(0.037, 0.062, 1.0).with(spun(&[(0.012, 0.0), (0.004, 0.02)], 1.0), 0.0, 0.058, 0.0)
}

fn garlic() -> Shape {
    fruit(0.026, 0.034, 1.0).with(spun(&[(0.014, 0.0), (0.004, 0.024)], 1.0), 0.0, 0.031, 0.0)
}

fn carrot() -> Shape {
    let root = spun(&[(0.006, 0.0), (0.017, 0.15), (0.014, 0.165)], 1.0);
    block(0.09, 0.010, 0.016)
        .turned(root, rolled(0.09, 0.0175, 0.0, 0.5 * PI))
        .turned(cylinder(0.005, 0.03), along_x(-0.085, 0.0175, 0.0))
}

fn eggplant() -> Shape {
    let body = spun(&[(0.012, 0.0), (0.033, 0.03), (0.036, 0.07), (0.024, 0.15), (0.015, 0.18)], 1.0);
    block(0.07, 0.016, 0.034)
        .turned(body, rolled(0.09, 0.038, 0.0, 0.5 * PI))
        .turned(cylinder(0.009, 0.04), along_x(-0.105, 0.038, 0.0))
}

fn bell_pepper() -> Shape {
    lathe(&[(0.026, 0.0), (0.034, 0.012), (0.040, 0.055), (0.036, 0.078), (0.018, 0.085)]).with(
        stalk(0.006, 0.025),
        0.0,
        0.094,
        0.0,
    )
}

/// A head of florets about a stem.
fn crowned(radius_m: f32, stem_m: f32) -> Shape {
    let floret = 0.52 * radius_m;
    let at = 0.55 * radius_m;
    upright(0.55 * radius_m, stem_m)
        .with(ball(0.75 * radius_m), 0.0, stem_m + 0.55 * radius_m, 0.0)
        .with(ball(floret), at, stem_m + 0.4 * radius_m, 0.0)
        .with(ball(floret), -at, stem_m + 0.4 * radius_m, 0.0)
        .with(ball(floret), 0.0, stem_m + 0.4 * radius_m, at)
        .with(ball(floret), 0.0, stem_m + 0.4 * radius_m, -at)
}

fn broccoli() -> Shape {
    crowned(0.06, 0.07)
}

fn mushroom() -> Shape {
    upright(0.011, 0.028).with(
        spun(&[(0.020, 0.0), (0.024, 0.006), (0.018, 0.017), (0.006, 0.022)], 1.0),
        0.0,
        0.020,
        0.0,
    )
}

fn croissant() -> Shape {
    block(0.07, 0.02, 0.035)
        .turned(capsule(0.025, 0.09), along_x(0.0, 0.026, 0.0))
        .turned(capsule(0.018, 0.07), super::forms::lying(0.055, 0.024, 0.016, 0.6))
        .turned(capsule(0.018, 0.07), super::forms::lying(-0.055, 0.024, 0.016, -0.6))
}

fn cheese() -> Shape {
    let wedge = prism(&[(-0.07, -0.035), (-0.07, 0.035), (0.07, 0.0)], 0.05);
    block(0.06, 0.02, 0.03).joined(
        Shape::default().turned(wedge, super::forms::pitched(0.0, 0.027, 0.0, 0.5 * PI)),
        0.02,
        0.0,
        0.0,
    )
}

fn cake() -> Shape {
    upright(0.14, 0.008).with(cylinder(0.115, 0.075), 0.0, 0.045, 0.0).with(cuboid(0.02, 0.02, 0.02), 0.0, 0.092, 0.0)
}
