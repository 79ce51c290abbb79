//! A colour for each category: plausible for the thing, and apart from what it stands on.

use super::canvas::Rgb;

/// The robot's colour.
pub const ROBOT: Rgb = [238, 106, 36];

/// Where a section cuts something.
pub const SECTION: Rgb = [74, 78, 86];

/// sRGB colours of fixed things and of the best known movable ones. Fixed things are pale, movable ones are not.
const COLOURS: [(&str, Rgb); 74] = [
    ("Wall", [226, 222, 212]),
    ("Ceiling", [240, 240, 238]),
    ("Floor", [212, 190, 160]),
    ("CounterTop", [232, 228, 220]),
    ("Cabinet", [166, 184, 182]),
    ("Drawer", [150, 170, 170]),
    ("Fridge", [206, 212, 218]),
    ("Dishwasher", [192, 198, 204]),
    ("Microwave", [96, 102, 110]),
    ("StoveOven", [120, 124, 130]),
    ("StoveBurner", [48, 50, 54]),
    ("StoveKnob", [60, 62, 66]),
    ("Oven", [92, 96, 102]),
    ("Cooktop", [70, 72, 78]),
    ("RangeHood", [176, 182, 188]),
    ("Hood", [176, 182, 188]),
    ("Sink", [184, 194, 202]),
    ("SinkBasin", [184, 194, 202]),
    ("Faucet", [128, 138, 148]),
    ("Window", [166, 206, 232]),
    ("Blinds", [236, 226, 196]),
    ("Curtains", [214, 168, 158]),
    ("LightSwitch", [250, 250, 246]),
    ("Door", [184, 150, 112]),
    ("Shelf", [196, 160, 118]),
    ("ShelvingUnit", [184, 146, 104]),
    ("DiningTable", [186, 138, 92]),
    ("SideTable", [186, 138, 92]),
    ("Handle", [120, 124, 128]),
    ("ToeKick", [86, 88, 92]),
    ("Chair", [150, 96, 58]),
    ("Stool", [140, 92, 60]),
    ("GarbageCan", [84, 104, 96]),
    ("CoffeeMachine", [52, 54, 62]),
    ("Toaster", [196, 64, 52]),
    ("HousePlant", [66, 138, 74]),
    ("Kettle", [112, 128, 148]),
    ("Pan", [58, 62, 72]),
    ("Pot", [90, 106, 128]),
    ("Bread", [204, 142, 70]),
    ("Plate", [244, 246, 250]),
    ("Bowl", [92, 156, 206]),
    ("Spatula", [44, 122, 130]),
    ("Ladle", [104, 112, 124]),
    ("Knife", [120, 128, 140]),
    ("ButterKnife", [140, 148, 158]),
    ("Fork", [140, 148, 158]),
    ("Spoon", [140, 148, 158]),
    ("Book", [126, 72, 132]),
    ("Lettuce", [112, 186, 66]),
    ("PaperTowelRoll", [248, 248, 244]),
    ("Vase", [74, 116, 178]),
    ("WineBottle", [48, 88, 56]),
    ("Bottle", [72, 146, 120]),
    ("SoapBottle", [64, 152, 214]),
    ("Mug", [44, 92, 170]),
    ("Cup", [232, 156, 188]),
    ("DishSponge", [240, 206, 64]),
    ("Potato", [186, 152, 94]),
    ("Apple", [212, 40, 48]),
    ("Tomato", [230, 74, 40]),
    ("Egg", [244, 226, 198]),
    ("SaltShaker", [240, 240, 244]),
    ("PepperShaker", [72, 64, 62]),
    ("CellPhone", [36, 38, 46]),
    ("Statue", [150, 134, 112]),
    ("SprayBottle", [84, 176, 202]),
    ("AluminumFoil", [188, 196, 206]),
    ("CreditCard", [52, 92, 156]),
    ("Pen", [32, 52, 120]),
    ("Pencil", [232, 180, 52]),
    ("Robot", ROBOT),
    ("Rug", [168, 116, 110]),
    ("Mirror", [190, 214, 226]),
];

/// Colours for everything else, told apart by name.
const OTHERS: [Rgb; 12] = [
    [196, 92, 96],
    [214, 142, 62],
    [206, 186, 82],
    [132, 170, 78],
    [78, 158, 118],
    [76, 158, 168],
    [84, 128, 190],
    [116, 104, 186],
    [164, 98, 174],
    [196, 104, 148],
    [150, 120, 92],
    [116, 128, 140],
];

/// An sRGB channel as linear light, 0 to 1.
pub fn linear(channel: u8) -> f32 {
    let c = f32::from(channel) / 255.0;
    if c <= 0.04045 { c / 12.92 } else { libm::powf((c + 0.055) / 1.055, 2.4) }
}

/// sRGB colour of a category.
pub fn colour(category: &str) -> Rgb {
    if let Some((_, colour)) = COLOURS.iter().find(|(name, _)| *name == category) {
        return *colour;
    }
    let sum = category.bytes().fold(7_usize, |sum, byte| (sum * 31 + usize::from(byte)) % 9973);
    OTHERS[sum % OTHERS.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_category_is_named_once_and_any_name_has_a_colour() {
        for (index, (name, _)) in COLOURS.iter().enumerate() {
            assert!(COLOURS[..index].iter().all(|(other, _)| other != name), "{name} stands here twice");
        }
        assert_eq!(colour("Apple"), [212, 40, 48]);
        assert_eq!(colour("AnythingElse"), colour("AnythingElse"));
    }
}
