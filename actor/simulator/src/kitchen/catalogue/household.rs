use super::category::Material::{Ceramic, Cloth, Glass, Metal, Paper, Plastic, Wood};
use super::category::Place::{Counter, Floor, Shelf, Sink, Surface, Table};
use super::category::{Category, thing};
use super::colour::{
    BLACK, BLUE, COPPER, CREAM, DARK_GREEN, DARK_WOOD, GREEN, GREY, PINK, RED, STEEL, TERRACOTTA, WHITE, WICKER, WOOD,
    YELLOW,
};
use super::forms::{
    along_x, along_z, ball, block, capsule, cuboid, cylinder, handle, lathe, open_box, oval, pitched, rolled, spun,
    upright,
};
use crate::shape::Shape;

pub const HOUSEHOLD: &[Category] = &[
    thing("DishSponge", 0.05, Cloth, YELLOW, Surface, || {
        block(0.11, 0.022, 0.07).with(cuboid(0.11, 0.010, 0.07), 0.0, 0.026, 0.0)
    })
    .every(),
    thing("PaperTowelRoll", 0.5, Paper, WHITE, Counter, paper_towel_roll).some(10, 1.0),
    thing("HousePlant", 1.8, Ceramic, DARK_GREEN, Surface, house_plant).some(10, 1.1),
    thing("Vase", 0.8, Ceramic, BLUE, Surface, vase).some(6, 2.67),
    thing("Statue", 1.5, Ceramic, GREY, Shelf, statue).some(4, 1.25),
    thing("Book", 0.6, Paper, RED, Surface, book).some(2, 1.0),
    thing("CellPhone", 0.18, Glass, BLACK, Surface, || block(0.15, 0.009, 0.072)).some(4, 1.0),
    thing("CreditCard", 0.02, Plastic, BLUE, Surface, || block(0.086, 0.006, 0.054)).some(3, 1.0),
    thing("Pen", 0.02, Plastic, BLUE, Surface, || pen(0.14, 0.010)).some(2, 1.0),
    thing("Pencil", 0.02, Wood, YELLOW, Surface, || pen(0.18, 0.008)).some(2, 1.0),
    thing("KnifeBlock", 1.6, Wood, WOOD, Counter, knife_block),
    thing("DishRack", 0.9, Metal, STEEL, Counter, dish_rack),
    thing("TeaTowel", 0.09, Cloth, BLUE, Counter, || {
        block(0.24, 0.012, 0.17).with(cuboid(0.22, 0.010, 0.08), 0.0, 0.016, 0.03)
    }),
    thing("OvenMitt", 0.14, Cloth, RED, Counter, oven_mitt),
    thing("PotHolder", 0.06, Cloth, RED, Counter, || block(0.18, 0.012, 0.18)),
    thing("Trivet", 0.3, Wood, WOOD, Table, || upright(0.09, 0.012)),
    thing("Coaster", 0.04, Wood, DARK_WOOD, Table, || upright(0.048, 0.006)),
    thing("Placemat", 0.12, Cloth, CREAM, Table, || block(0.42, 0.005, 0.30)),
    thing("NapkinHolder", 0.4, Metal, STEEL, Table, napkin_holder),
    thing("Candle", 0.35, Cloth, CREAM, Table, || upright(0.035, 0.10).with(cylinder(0.002, 0.014), 0.0, 0.107, 0.0)),
    thing("Candlestick", 0.6, Metal, COPPER, Table, candlestick),
    thing("TableClock", 0.5, Wood, DARK_WOOD, Shelf, table_clock),
    thing("PictureFrame", 0.4, Wood, DARK_WOOD, Shelf, picture_frame),
    thing("Basket", 0.5, Wood, WICKER, Shelf, basket),
    thing("TissueBox", 0.25, Paper, BLUE, Surface, || {
        block(0.23, 0.075, 0.12).with(cuboid(0.06, 0.03, 0.02), 0.0, 0.09, 0.0)
    }),
    thing("Notepad", 0.15, Paper, YELLOW, Counter, || block(0.15, 0.012, 0.21)),
    thing("Newspaper", 0.3, Paper, CREAM, Table, || block(0.30, 0.014, 0.21)),
    thing("CookbookStand", 1.3, Wood, WOOD, Counter, cookbook_stand),
    thing("RecipeBox", 0.6, Wood, WOOD, Shelf, || {
        block(0.17, 0.09, 0.12).with(cuboid(0.175, 0.03, 0.125), 0.0, 0.10, 0.0)
    }),
    thing("TabletComputer", 0.48, Glass, BLACK, Table, || block(0.25, 0.008, 0.175)),
    thing("LaptopComputer", 1.5, Plastic, GREY, Table, laptop),
    thing("RemoteControl", 0.1, Plastic, BLACK, Table, || block(0.17, 0.018, 0.045)),
    thing("Keys", 0.08, Metal, STEEL, Counter, || {
        block(0.06, 0.005, 0.022).with(cylinder(0.014, 0.006), -0.035, 0.003, 0.0).with(
            cuboid(0.05, 0.005, 0.014),
            -0.03,
            0.0025,
            0.025,
        )
    }),
    thing("Flashlight", 0.25, Metal, BLACK, Shelf, || {
        lathe(&[(0.024, 0.0), (0.024, 0.03), (0.015, 0.05)]).with(cylinder(0.015, 0.11), 0.0, 0.105, 0.0)
    }),
    thing("MatchBox", 0.012, Paper, RED, Stove, || block(0.054, 0.016, 0.036)),
    thing("TableLamp", 1.6, Ceramic, CREAM, Surface, table_lamp),
    thing("HerbPot", 0.6, Ceramic, DARK_GREEN, Counter, herb_pot),
    thing("Succulent", 0.4, Ceramic, GREEN, Shelf, succulent),
    thing("Cactus", 0.7, Ceramic, GREEN, Shelf, cactus),
    thing("FlowerPot", 0.7, Ceramic, TERRACOTTA, Surface, || pot_and_soil(0.055, 0.075, 0.13)),
    thing("WateringCan", 0.6, Metal, GREEN, Counter, watering_can),
    thing("DishBrush", 0.09, Wood, WOOD, Sink, dish_brush),
    thing("ScouringPad", 0.03, Metal, STEEL, Sink, || lathe(&[(0.030, 0.0), (0.038, 0.012), (0.030, 0.028)])),
    thing("SoapBar", 0.1, Plastic, PINK, Sink, || block(0.075, 0.024, 0.05)),
    thing("SoapDish", 0.18, Ceramic, WHITE, Sink, || oval(&[(0.035, 0.0), (0.045, 0.016), (0.045, 0.02)], 1.4)),
    thing("Basin", 0.6, Plastic, WHITE, Sink, || open_box(0.34, 0.13, 0.28, 0.006)),
    thing("DishCloth", 0.05, Cloth, PINK, Sink, || block(0.15, 0.014, 0.15)),
    thing("WineRack", 1.8, Wood, DARK_WOOD, Counter, wine_rack),
    thing("FirstAidBox", 0.9, Plastic, RED, Shelf, || {
        block(0.22, 0.15, 0.08).turned(capsule(0.008, 0.09), along_x(0.0, 0.165, 0.0))
    }),
    thing("PiggyBank", 0.5, Ceramic, PINK, Shelf, piggy_bank),
    thing("Doorstop", 0.3, super::category::Material::Rubber, BLACK, Floor, doorstop),
    thing("Dustpan", 0.3, Plastic, BLUE, Floor, dustpan),
    thing("ShoppingBag", 1.2, Paper, super::colour::KRAFT, Floor, || open_box(0.30, 0.34, 0.17, 0.008)),
    thing("ToolBox", 4.5, Metal, RED, Floor, tool_box),
];

use super::category::Place::Stove;

fn paper_towel_roll() -> Shape {
    upright(0.075, 0.012)
        .with(cylinder(0.058, 0.24), 0.0, 0.132, 0.0)
        .with(cylinder(0.008, 0.05), 0.0, 0.275, 0.0)
        .with(ball(0.013), 0.0, 0.305, 0.0)
}

fn pot_and_soil(low_m: f32, high_m: f32, height_m: f32) -> Shape {
    lathe(&[(low_m, 0.0), (high_m, height_m)]).with(
        cylinder(high_m + 0.006, 0.16 * height_m),
        0.0,
        0.92 * height_m,
        0.0,
    )
}

fn house_plant() -> Shape {
    pot_and_soil(0.06, 0.08, 0.13)
        .with(cylinder(0.008, 0.12), 0.0, 0.17, 0.0)
        .with(ball(0.085), 0.0, 0.29, 0.0)
        .with(ball(0.06), 0.065, 0.24, 0.03)
        .with(ball(0.055), -0.06, 0.25, 0.035)
        .with(ball(0.055), 0.005, 0.25, -0.065)
        .with(ball(0.05), 0.02, 0.36, 0.0)
}

fn vase() -> Shape {
    lathe(&[(0.04, 0.0), (0.06, 0.06), (0.058, 0.11), (0.028, 0.18)]).with(
        spun(&[(0.026, 0.0), (0.036, 0.035)], 1.0),
        0.0,
        0.175,
        0.0,
    )
}

fn statue() -> Shape {
    block(0.10, 0.04, 0.10)
        .with(spun(&[(0.038, 0.0), (0.030, 0.06), (0.040, 0.12), (0.016, 0.15)], 1.0), 0.0, 0.04, 0.0)
        .with(cylinder(0.012, 0.03), 0.0, 0.195, 0.0)
        .with(ball(0.026), 0.0, 0.225, 0.0)
}

fn book() -> Shape {
    block(0.22, 0.003, 0.155)
        .with(cuboid(0.21, 0.026, 0.148), 0.0, 0.015, 0.003)
        .with(cuboid(0.22, 0.003, 0.155), 0.0, 0.0285, 0.0)
        .with(cuboid(0.22, 0.03, 0.003), 0.0, 0.015, -0.076)
}

/// Six-sided, on one of its sides, as a box that bears and a tip.
fn pen(length_m: f32, width_m: f32) -> Shape {
    block(0.88 * length_m, width_m, 0.8 * width_m).turned(
        spun(&[(0.45 * width_m, 0.0), (0.1 * width_m, 0.12 * length_m)], 1.0),
        rolled(0.44 * length_m, 0.5 * width_m, 0.0, -std::f32::consts::FRAC_PI_2),
    )
}

fn knife_block() -> Shape {
    let knives = [(-0.03, 0.02), (0.0, 0.025), (0.03, 0.015)].into_iter().fold(
        block(0.11, 0.02, 0.17).turned(cuboid(0.10, 0.22, 0.09), pitched(0.0, 0.125, -0.005, -0.25)),
        |shape, (x, rise)| shape.turned(cuboid(0.016, 0.10, 0.024), pitched(x, 0.26 + rise, -0.045, -0.25)),
    );
    knives.with(cuboid(0.08, 0.08, 0.05), 0.0, 0.06, -0.03)
}

fn dish_rack() -> Shape {
    let rack = open_box(0.40, 0.012, 0.30, 0.010)
        .with(cuboid(0.40, 0.010, 0.010), 0.0, 0.115, 0.145)
        .with(cuboid(0.40, 0.010, 0.010), 0.0, 0.115, -0.145)
        .with(cuboid(0.010, 0.12, 0.30), 0.195, 0.06, 0.0)
        .with(cuboid(0.010, 0.12, 0.30), -0.195, 0.06, 0.0);
    (0..4)
        .fold(rack, |shape, index| shape.turned(cylinder(0.004, 0.28), along_z(0.09 * (index as f32 - 1.0), 0.06, 0.0)))
}

fn oven_mitt() -> Shape {
    block(0.20, 0.03, 0.14)
        .with(cylinder(0.07, 0.03), 0.10, 0.015, 0.0)
        .turned(cuboid(0.09, 0.026, 0.045), super::forms::yawed(0.02, 0.013, 0.09, 0.5))
}

fn napkin_holder() -> Shape {
    block(0.14, 0.008, 0.06)
        .with(cuboid(0.14, 0.10, 0.005), 0.0, 0.055, 0.027)
        .with(cuboid(0.14, 0.10, 0.005), 0.0, 0.055, -0.027)
        .with(cuboid(0.12, 0.12, 0.035), 0.0, 0.068, 0.0)
}

fn candlestick() -> Shape {
    upright(0.05, 0.012)
        .with(spun(&[(0.03, 0.0), (0.009, 0.03)], 1.0), 0.0, 0.012, 0.0)
        .with(cylinder(0.009, 0.12), 0.0, 0.09, 0.0)
        .with(cylinder(0.022, 0.02), 0.0, 0.16, 0.0)
        .with(cylinder(0.011, 0.16), 0.0, 0.25, 0.0)
}

fn table_clock() -> Shape {
    block(0.16, 0.03, 0.06)
        .turned(cylinder(0.07, 0.05), along_z(0.0, 0.095, 0.0))
        .turned(cylinder(0.055, 0.008), along_z(0.0, 0.095, 0.027))
}

fn picture_frame() -> Shape {
    block(0.16, 0.012, 0.08)
        .turned(cuboid(0.17, 0.21, 0.016), pitched(0.0, 0.112, -0.005, -0.15))
        .turned(cuboid(0.13, 0.17, 0.004), pitched(0.0, 0.112, 0.005, -0.15))
}

fn basket() -> Shape {
    open_box(0.30, 0.13, 0.22, 0.010)
        .turned(capsule(0.007, 0.10), along_z(0.155, 0.125, 0.0))
        .turned(capsule(0.007, 0.10), along_z(-0.155, 0.125, 0.0))
}

fn cookbook_stand() -> Shape {
    block(0.30, 0.018, 0.18)
        .with(cuboid(0.30, 0.03, 0.014), 0.0, 0.03, 0.08)
        .turned(cuboid(0.29, 0.26, 0.014), pitched(0.0, 0.135, -0.01, -0.3))
        .turned(cuboid(0.22, 0.24, 0.022), pitched(0.0, 0.14, 0.006, -0.3))
}

fn laptop() -> Shape {
    block(0.32, 0.018, 0.22).turned(cuboid(0.32, 0.21, 0.008), pitched(0.0, 0.12, -0.125, -0.2))
}

fn table_lamp() -> Shape {
    upright(0.07, 0.015)
        .with(spun(&[(0.04, 0.0), (0.06, 0.06), (0.02, 0.15)], 1.0), 0.0, 0.015, 0.0)
        .with(cylinder(0.008, 0.08), 0.0, 0.20, 0.0)
        .with(spun(&[(0.12, 0.0), (0.075, 0.17)], 1.0), 0.0, 0.22, 0.0)
}

fn herb_pot() -> Shape {
    pot_and_soil(0.042, 0.055, 0.10)
        .with(ball(0.045), 0.0, 0.135, 0.0)
        .with(ball(0.032), 0.03, 0.15, 0.014)
        .with(ball(0.032), -0.026, 0.155, 0.018)
        .with(ball(0.030), 0.0, 0.165, -0.026)
}

fn succulent() -> Shape {
    let rosette = spun(&[(0.02, 0.0), (0.048, 0.024)], 1.0);
    pot_and_soil(0.034, 0.042, 0.06).with(rosette, 0.0, 0.058, 0.0).with(
        spun(&[(0.02, 0.0), (0.03, 0.02), (0.006, 0.032)], 1.0),
        0.0,
        0.074,
        0.0,
    )
}

fn cactus() -> Shape {
    pot_and_soil(0.042, 0.052, 0.08)
        .with(capsule(0.028, 0.16), 0.0, 0.14, 0.0)
        .turned(capsule(0.013, 0.06), along_x(0.045, 0.145, 0.0))
        .with(capsule(0.013, 0.06), 0.068, 0.165, 0.0)
}

fn watering_can() -> Shape {
    lathe(&[(0.065, 0.0), (0.06, 0.13)])
        .turned(cylinder(0.009, 0.20), rolled(-0.12, 0.11, 0.0, 0.8))
        .turned(spun(&[(0.012, 0.0), (0.028, 0.03)], 1.0), rolled(-0.19, 0.178, 0.0, 0.8))
        .joined(handle(0.055, 0.085, 0.05, 0.11, 0.012), 0.0, 0.0, 0.0)
}

fn dish_brush() -> Shape {
    block(0.06, 0.026, 0.05)
        .with(cuboid(0.066, 0.014, 0.056), 0.0, 0.033, 0.0)
        .with(cuboid(0.20, 0.012, 0.018), -0.12, 0.034, 0.0)
        .with(cuboid(0.012, 0.034, 0.022), -0.21, 0.017, 0.0)
}

fn wine_rack() -> Shape {
    let frame = block(0.36, 0.012, 0.20)
        .with(cuboid(0.012, 0.20, 0.20), 0.174, 0.10, 0.0)
        .with(cuboid(0.012, 0.20, 0.20), -0.174, 0.10, 0.0)
        .with(cuboid(0.36, 0.012, 0.20), 0.0, 0.10, 0.0)
        .with(cuboid(0.36, 0.012, 0.20), 0.0, 0.194, 0.0);
    (0..2).fold(frame, |shape, index| shape.with(cuboid(0.012, 0.18, 0.20), 0.116 * (index as f32 - 0.5), 0.10, 0.0))
}

fn piggy_bank() -> Shape {
    super::forms::legs(0.018, 0.03, 0.04, 0.025)
        .turned(capsule(0.045, 0.14), along_x(0.0, 0.065, 0.0))
        .turned(cylinder(0.018, 0.02), along_x(0.075, 0.065, 0.0))
}

fn doorstop() -> Shape {
    block(0.12, 0.014, 0.045).with(cuboid(0.07, 0.014, 0.045), -0.025, 0.021, 0.0).with(
        cuboid(0.03, 0.014, 0.045),
        -0.045,
        0.035,
        0.0,
    )
}

fn dustpan() -> Shape {
    block(0.22, 0.008, 0.22)
        .with(cuboid(0.008, 0.06, 0.22), 0.106, 0.03, 0.0)
        .with(cuboid(0.008, 0.06, 0.22), -0.106, 0.03, 0.0)
        .with(cuboid(0.22, 0.06, 0.008), 0.0, 0.03, -0.106)
        .turned(capsule(0.012, 0.16), along_z(0.0, 0.05, -0.18))
}

fn tool_box() -> Shape {
    block(0.42, 0.16, 0.20)
        .with(cuboid(0.43, 0.04, 0.21), 0.0, 0.17, 0.0)
        .with(cuboid(0.014, 0.04, 0.03), 0.07, 0.21, 0.0)
        .with(cuboid(0.014, 0.04, 0.03), -0.07, 0.21, 0.0)
        .turned(capsule(0.011, 0.17), along_x(0.0, 0.235, 0.0))
}
