use super::canvas::Rgb;
use simulator::kitchen::catalogue::CATEGORIES;

pub(crate) const ROBOT: Rgb = [238, 106, 36];

pub(crate) const SECTION: Rgb = [74, 78, 86];

/// sRGB colours of fixed things: pale, so that movable ones stand out.
const FIXED: [(&str, Rgb); 30] = [
    ("Wall", [226, 222, 212]),
    ("Ceiling", [240, 240, 238]),
    ("Floor", [212, 190, 160]),
    ("CounterTop", [232, 228, 220]),
    ("Cabinet", [166, 184, 182]),
    ("CornerUnit", [166, 184, 182]),
    ("DrawerUnit", [166, 184, 182]),
    ("Filler", [158, 176, 174]),
    ("Drawer", [150, 170, 170]),
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

pub fn colour(category: &str) -> Rgb {
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
        assert_eq!(colour("Window"), [166, 206, 232]);
        assert_eq!(colour("AnythingElse"), colour("AnythingElse"));
    }
}
