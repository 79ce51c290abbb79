use super::canvas::Rgb;
use simulator::kitchen::catalogue::CATEGORIES;

pub(crate) const ROBOT: Rgb = [238, 106, 36];

pub(crate) const SECTION: Rgb = [74, 78, 86];

/// sRGB colours of fixed things: pale, so that movable ones stand out.
const FIXED: [(&str, Rgb); 23] = [
    ("Wall", [226, 222, 212]),
    ("Ceiling", [240, 240, 238]),
    ("Fridge", [206, 212, 218]),
    ("Dishwasher", [192, 198, 204]),
    ("Microwave", [96, 102, 110]),
    ("StoveOven", [120, 124, 130]),
    ("StoveBurner", [48, 50, 54]),
    ("StoveKnob", [60, 62, 66]),
    ("RangeHood", [176, 182, 188]),
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
    ("Safe", [88, 92, 100]),
    ("Mirror", [190, 214, 226]),
];

/// Cabinets, counters and floor of a kitchen: so that one kitchen is told from another.
const TONES: [[Rgb; 3]; 6] = [
    [[206, 202, 194], [176, 170, 164], [190, 166, 138]],
    [[166, 184, 182], [232, 228, 220], [212, 190, 160]],
    [[148, 168, 192], [226, 224, 222], [202, 196, 186]],
    [[204, 180, 146], [222, 220, 216], [186, 182, 176]],
    [[168, 178, 146], [230, 222, 206], [206, 180, 146]],
    [[190, 160, 152], [234, 230, 226], [214, 200, 182]],
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

pub fn linear(channel: u8) -> f32 {
    let c = f32::from(channel) / 255.0;
    if c <= 0.04045 { c / 12.92 } else { libm::powf((c + 0.055) / 1.055, 2.4) }
}

/// sRGB colour of a category in a kitchen with this number.
pub fn colour(category: &str, kitchen: u32) -> Rgb {
    let [cabinets, counters, floor] = TONES[kitchen as usize % TONES.len()];
    match category {
        "Cabinet" | "CornerUnit" | "DrawerUnit" => return cabinets,
        "Filler" | "Drawer" => return cabinets.map(|channel| channel - 12),
        "CounterTop" => return counters,
        "Floor" => return floor,
        _ => {}
    }
    if let Some(movable) = CATEGORIES.iter().find(|movable| movable.name == category) {
        return movable.colour;
    }
    if let Some((_, colour)) = FIXED.iter().find(|(name, _)| *name == category) {
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
        for (index, (name, _)) in FIXED.iter().enumerate() {
            assert!(FIXED[..index].iter().all(|(other, _)| other != name), "{name} stands here twice");
            assert!(CATEGORIES.iter().all(|movable| movable.name != *name), "{name} is movable");
        }
        assert_eq!(colour("Window", 1), [166, 206, 232]);
        assert_eq!(colour("AnythingElse", 1), colour("AnythingElse", 2));
    }
}
