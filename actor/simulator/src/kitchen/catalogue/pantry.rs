//! Bottles, jars, cans, packets: what food and soap are kept in.

use super::category::Material::{Ceramic, Glass, Metal, Paper, Plastic, Wood};
use super::category::Place::{Counter, Shelf, Sink, Stove, Surface, Table};
use super::category::{Category, thing};
use super::colour::{
    AMBER_GLASS, BLUE, BROWN, CREAM, GLASS, GREEN, GREEN_GLASS, GREY, KRAFT, ORANGE, RED, STEEL, WHITE, WOOD, YELLOW,
};
use super::forms::{along_x, basin, block, bottle, capsule, cuboid, cylinder, jar, lathe, prism, spun, upright, yawed};
use crate::shape::Shape;

pub const PANTRY: &[Category] = &[
    thing("SoapBottle", 0.4, Plastic, GREEN, Surface, soap_bottle).every(),
    thing("SaltShaker", 0.12, Glass, WHITE, Surface, || shaker(0.022, 0.075)).every(),
    thing("PepperShaker", 0.12, Glass, GREY, Surface, || shaker(0.022, 0.085)).every(),
    thing("WineBottle", 1.2, Glass, GREEN_GLASS, Surface, || bottle(0.037, 0.19, 0.014, 0.11)).some(10, 1.0),
    thing("Bottle", 0.6, Glass, GLASS, Surface, || bottle(0.033, 0.15, 0.013, 0.07)).some(7, 1.0),
    thing("SprayBottle", 0.5, Plastic, BLUE, Surface, spray_bottle).some(2, 1.0),
    thing("AluminumFoil", 0.4, Paper, BLUE, Surface, || block(0.31, 0.05, 0.05)).some(1, 3.0),
    thing("OilBottle", 0.95, Glass, GREEN_GLASS, Surface, || bottle(0.034, 0.20, 0.013, 0.08)),
    thing("VinegarBottle", 0.8, Glass, AMBER_GLASS, Shelf, || bottle(0.032, 0.17, 0.012, 0.09)),
    thing("BeerBottle", 0.75, Glass, AMBER_GLASS, Surface, || bottle(0.031, 0.13, 0.012, 0.10)),
    thing("LiquorBottle", 1.2, Glass, AMBER_GLASS, Shelf, liquor_bottle),
    thing("KetchupBottle", 0.55, Plastic, RED, Surface, ketchup_bottle),
    thing("MustardBottle", 0.35, Plastic, YELLOW, Surface, || jar(0.028, 0.12, 0.012, 0.045)),
    thing("SoySauceBottle", 0.3, Glass, RED, Surface, || bottle(0.026, 0.085, 0.012, 0.05)),
    thing("HotSauceBottle", 0.2, Glass, RED, Surface, || bottle(0.021, 0.10, 0.010, 0.055)),
    thing("SyrupBottle", 0.5, Plastic, BROWN, Table, syrup_bottle),
    thing("SodaBottle", 1.6, Plastic, BROWN, Surface, || bottle(0.048, 0.22, 0.016, 0.095)),
    thing("SodaCan", 0.37, Metal, RED, Surface, || can(0.033, 0.115)),
    thing("FoodCan", 0.47, Metal, STEEL, Shelf, || can(0.037, 0.108)),
    thing("TunaCan", 0.2, Metal, YELLOW, Shelf, || can(0.043, 0.038)),
    thing("JamJar", 0.45, Glass, RED, Surface, || jar(0.033, 0.085, 0.034, 0.014)),
    thing("HoneyJar", 0.65, Glass, ORANGE, Surface, || jar(0.040, 0.095, 0.037, 0.016)),
    thing("PickleJar", 0.95, Glass, GREEN, Shelf, || jar(0.043, 0.13, 0.039, 0.016)),
    thing("PasteJar", 0.6, Glass, BROWN, Shelf, || jar(0.040, 0.10, 0.041, 0.018)),
    thing("SpiceJar", 0.1, Glass, ORANGE, Shelf, || jar(0.022, 0.085, 0.021, 0.018)),
    thing("MasonJar", 0.6, Glass, GLASS, Shelf, || bottle_jar(0.042, 0.11)),
    thing("CookieJar", 1.3, Ceramic, CREAM, Counter, cookie_jar),
    thing("Canister", 0.9, Metal, WHITE, Counter, || jar(0.055, 0.17, 0.057, 0.022)),
    thing("CoffeeTin", 0.6, Metal, BROWN, Shelf, || jar(0.050, 0.13, 0.052, 0.012)),
    thing("TeaTin", 0.25, Metal, GREEN, Shelf, || {
        block(0.08, 0.10, 0.08).with(cuboid(0.084, 0.024, 0.084), 0.0, 0.110, 0.0)
    }),
    thing("ProteinTub", 1.2, Plastic, WHITE, Shelf, || jar(0.075, 0.18, 0.065, 0.03)),
    thing("CrispsTube", 0.25, Paper, GREEN, Shelf, || jar(0.038, 0.23, 0.040, 0.012)),
    thing("SaltCylinder", 0.55, Paper, BLUE, Shelf, || upright(0.041, 0.135)),
    thing("CerealBox", 0.5, Paper, ORANGE, Shelf, || block(0.19, 0.28, 0.065)),
    thing("PastaBox", 0.55, Paper, BLUE, Shelf, || block(0.09, 0.20, 0.05)),
    thing("CrackerBox", 0.3, Paper, RED, Shelf, || block(0.15, 0.21, 0.06)),
    thing("OatsBox", 0.6, Paper, BLUE, Shelf, || block(0.12, 0.20, 0.08)),
    thing("TeaBox", 0.12, Paper, GREEN, Shelf, || block(0.13, 0.075, 0.065)),
    thing("SugarPacket", 1.02, Paper, WHITE, Shelf, || paper_bag(0.10, 0.15, 0.065)),
    thing("FlourPacket", 1.02, Paper, KRAFT, Shelf, || paper_bag(0.11, 0.17, 0.07)),
    thing("RicePacket", 1.0, Plastic, WHITE, Shelf, || paper_bag(0.12, 0.19, 0.06)),
    thing("CoffeePacket", 0.5, Plastic, BROWN, Shelf, || paper_bag(0.09, 0.16, 0.06)),
    thing("MilkCarton", 1.05, Paper, WHITE, Surface, || carton(0.07, 0.195)),
    thing("JuiceCarton", 1.07, Paper, ORANGE, Surface, juice_carton),
    thing("CreamCarton", 0.52, Paper, BLUE, Surface, || carton(0.055, 0.12)),
    thing("EggCarton", 0.75, Paper, GREY, Surface, egg_carton),
    thing("ButterPacket", 0.26, Paper, YELLOW, Surface, || block(0.11, 0.038, 0.065)),
    thing("YogurtCup", 0.18, Plastic, WHITE, Surface, || {
        lathe(&[(0.027, 0.0), (0.034, 0.075)]).with(cylinder(0.036, 0.004), 0.0, 0.077, 0.0)
    }),
    thing("MargarineTub", 0.53, Plastic, YELLOW, Surface, || {
        lathe(&[(0.055, 0.0), (0.065, 0.07)]).with(cylinder(0.067, 0.008), 0.0, 0.072, 0.0)
    }),
    thing("ChocolateBar", 0.11, Paper, BROWN, Surface, || block(0.16, 0.012, 0.077)),
    thing("FoodContainer", 0.45, Plastic, BLUE, Surface, || lidded_box(0.20, 0.07, 0.14)),
    thing("LunchBox", 0.5, Plastic, RED, Counter, || lidded_box(0.18, 0.065, 0.13)),
    thing("BreadBox", 2.6, Wood, WOOD, Counter, bread_box),
    thing("ClingFilm", 0.35, Paper, GREEN, Counter, || block(0.31, 0.052, 0.052)),
    thing("BakingPaper", 0.3, Paper, KRAFT, Counter, || block(0.40, 0.050, 0.050)),
    thing("Detergent", 1.1, Plastic, BLUE, Sink, detergent),
    thing("DishwasherTablets", 0.8, Paper, BLUE, Shelf, || block(0.16, 0.19, 0.08)),
    thing("SpiceRack", 1.9, Wood, WOOD, Counter, spice_rack),
    thing("UtensilCrock", 1.1, Ceramic, CREAM, Stove, utensil_crock),
    thing("PetFoodBag", 2.1, Paper, RED, super::category::Place::Floor, || paper_bag(0.22, 0.36, 0.11)),
];

fn soap_bottle() -> Shape {
    jar(0.033, 0.14, 0.016, 0.022).with(cylinder(0.006, 0.036), 0.0, 0.178, 0.0).with(
        cuboid(0.05, 0.012, 0.014),
        0.015,
        0.196,
        0.0,
    )
}

fn shaker(radius_m: f32, height_m: f32) -> Shape {
    let cap = spun(&[(radius_m, 0.0), (0.95 * radius_m, 0.008), (0.5 * radius_m, 0.016)], 1.0);
    upright(radius_m, height_m).with(cap, 0.0, height_m, 0.0)
}

fn spray_bottle() -> Shape {
    bottle(0.040, 0.15, 0.014, 0.055).with(cuboid(0.09, 0.028, 0.026), 0.014, 0.215, 0.0).with(
        cuboid(0.010, 0.05, 0.014),
        0.038,
        0.185,
        0.0,
    )
}

fn liquor_bottle() -> Shape {
    block(0.085, 0.16, 0.06).with(cylinder(0.026, 0.02), 0.0, 0.168, 0.0).with(cylinder(0.014, 0.09), 0.0, 0.21, 0.0)
}

/// Stands on its cap.
fn ketchup_bottle() -> Shape {
    upright(0.030, 0.03).with(spun(&[(0.026, 0.0), (0.034, 0.03), (0.036, 0.10), (0.022, 0.16)], 1.15), 0.0, 0.03, 0.0)
}

fn syrup_bottle() -> Shape {
    lathe(&[(0.035, 0.0), (0.038, 0.02), (0.036, 0.09), (0.014, 0.15)]).with(cylinder(0.015, 0.03), 0.0, 0.163, 0.0)
}

fn can(radius_m: f32, height_m: f32) -> Shape {
    upright(0.96 * radius_m, height_m).with(cylinder(radius_m, 0.90 * height_m), 0.0, 0.5 * height_m, 0.0)
}

fn bottle_jar(radius_m: f32, height_m: f32) -> Shape {
    bottle(radius_m, height_m, 0.82 * radius_m, 0.03).with(cylinder(0.88 * radius_m, 0.016), 0.0, height_m + 0.026, 0.0)
}

fn cookie_jar() -> Shape {
    lathe(&[(0.065, 0.0), (0.088, 0.04), (0.090, 0.12), (0.070, 0.16)])
        .with(spun(&[(0.072, 0.0), (0.072, 0.010), (0.040, 0.03), (0.015, 0.034)], 1.0), 0.0, 0.16, 0.0)
        .with(super::forms::ball(0.016), 0.0, 0.206, 0.0)
}

fn paper_bag(x_m: f32, y_m: f32, z_m: f32) -> Shape {
    let (half_x, half_z) = (0.5 * x_m, 0.5 * z_m);
    let points_m = [(0.0, 0.96, 0.92), (0.25, 1.0, 1.0), (0.8, 0.98, 0.95), (1.0, 0.90, 0.35)]
        .into_iter()
        .flat_map(|(y, x, z)| {
            [(1.0, 1.0), (-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)]
                .map(|(u, v)| rapier3d::math::Vec3::new(u * x * half_x, 0.003 + y * y_m, v * z * half_z))
        })
        .collect();
    block(0.9 * x_m, 0.02, 0.85 * z_m).with(crate::shape::Primitive::Hull { points_m }, 0.0, 0.0, 0.0).with(
        cuboid(0.85 * x_m, 0.025, 0.2 * z_m),
        0.0,
        y_m + 0.01,
        0.0,
    )
}

fn carton(side_m: f32, height_m: f32) -> Shape {
    let half_m = 0.5 * side_m;
    block(side_m, height_m, side_m)
        .with(
            prism(
                &[(-half_m, 0.0), (half_m, 0.0), (0.06 * side_m, 0.4 * side_m), (-0.06 * side_m, 0.4 * side_m)],
                side_m,
            ),
            0.0,
            height_m,
            0.0,
        )
        .with(cuboid(0.006, 0.02, side_m), 0.0, height_m + 0.45 * side_m, 0.0)
}

fn juice_carton() -> Shape {
    block(0.075, 0.195, 0.075).with(cylinder(0.013, 0.016), 0.016, 0.203, 0.0)
}

fn egg_carton() -> Shape {
    let half_m = 0.052;
    let lid = prism(&[(-half_m, 0.0), (half_m, 0.0), (0.045, 0.03), (-0.045, 0.03)], 0.29);
    block(0.29, 0.038, 0.104).turned(lid, yawed(0.0, 0.038, 0.0, 0.5 * std::f32::consts::PI))
}

fn lidded_box(x_m: f32, y_m: f32, z_m: f32) -> Shape {
    block(0.95 * x_m, y_m, 0.95 * z_m).with(cuboid(x_m, 0.012, z_m), 0.0, y_m, 0.0)
}

fn bread_box() -> Shape {
    block(0.36, 0.08, 0.24)
        .turned(cylinder(0.10, 0.35), along_x(0.0, 0.10, 0.0))
        .with(cuboid(0.36, 0.12, 0.12), 0.0, 0.14, -0.06)
        .turned(capsule(0.010, 0.05), along_x(0.0, 0.10, 0.105))
}

fn detergent() -> Shape {
    block(0.09, 0.19, 0.06)
        .with(prism(&[(-0.045, 0.0), (0.045, 0.0), (0.016, 0.04), (-0.016, 0.04)], 0.05), 0.0, 0.19, 0.0)
        .with(cylinder(0.016, 0.03), 0.0, 0.243, 0.0)
}

fn spice_rack() -> Shape {
    let jars = (0..5).fold(Shape::default(), |shape, index| {
        shape.joined(jar(0.022, 0.085, 0.021, 0.016), 0.055 * (index as f32 - 2.0), 0.012, 0.0)
    });
    jars.with(cuboid(0.30, 0.012, 0.065), 0.0, 0.006, 0.0).with(cuboid(0.30, 0.05, 0.008), 0.0, 0.025, -0.032).with(
        cuboid(0.30, 0.02, 0.008),
        0.0,
        0.022,
        0.032,
    )
}

fn utensil_crock() -> Shape {
    let rod = |x: f32, z: f32| capsule_at(x, z);
    basin(0.055, 0.062, 0.15, 0.008, 8).joined(rod(0.025, 0.015), 0.0, 0.0, 0.0).joined(
        rod(-0.028, 0.004),
        0.0,
        0.0,
        0.0,
    )
}

/// A spoon that stands in a crock.
fn capsule_at(x_m: f32, z_m: f32) -> Shape {
    Shape::default().with(capsule(0.006, 0.26), x_m, 0.14, z_m).with(
        spun(&[(0.010, 0.0), (0.024, 0.02), (0.018, 0.05)], 0.4),
        x_m,
        0.255,
        z_m,
    )
}
