//! What iTHOR's kitchens hold: the figures that ours are made after and compared with.
//!
//! Counted from the object list of the 30 kitchens of AI2-THOR (`vibrations.csv` of the public code of Ni et al.,
//! *Towards Disturbance-Free Visual Mobile Manipulation*): categories, positions, nothing else.

const KITCHENS: f32 = 30.0;
/// Things in a kitchen: least, median, most.
pub const THINGS: [f32; 3] = [54.0, 68.5, 90.0];
/// Extent of the objects' centres along x, metres: least, median, largest.
pub(super) const EXTENT_X_M: [f32; 3] = [2.74, 4.23, 9.18];
/// Extent of the objects' centres along z, metres: least, median, largest.
pub(super) const EXTENT_Z_M: [f32; 3] = [2.61, 4.78, 7.05];
/// Categories that are not counted as things: iTHOR has no objects for them.
pub const NOT_THINGS: [&str; 10] =
    ["Wall", "Ceiling", "Robot", "Door", "Filler", "CornerUnit", "DrawerUnit", "StoveOven", "Dishwasher", "RangeHood"];

/// Categories: name, kitchens of 30 that have it, how many those have on average.
pub const CATEGORIES: [(&str, u32, f32); 63] = [
    ("StoveBurner", 30, 4.1),
    ("CounterTop", 30, 2.37),
    ("Cabinet", 30, 13.93),
    ("StoveKnob", 30, 4.1),
    ("Sink", 30, 1.0),
    ("Floor", 30, 1.0),
    ("Knife", 30, 1.0),
    ("Microwave", 30, 1.0),
    ("Bread", 30, 1.0),
    ("Fork", 30, 1.0),
    ("Potato", 30, 1.0),
    ("Toaster", 30, 1.0),
    ("SoapBottle", 30, 1.0),
    ("Pan", 30, 1.0),
    ("Plate", 30, 1.0),
    ("Tomato", 30, 1.0),
    ("GarbageCan", 30, 1.0),
    ("Egg", 30, 1.0),
    ("Pot", 30, 1.0),
    ("Spatula", 30, 1.0),
    ("Cup", 30, 1.0),
    ("Fridge", 30, 1.0),
    ("CoffeeMachine", 30, 1.0),
    ("Bowl", 30, 1.0),
    ("SinkBasin", 30, 1.0),
    ("SaltShaker", 30, 1.0),
    ("PepperShaker", 30, 1.0),
    ("Lettuce", 30, 1.0),
    ("ButterKnife", 30, 1.0),
    ("Apple", 30, 1.0),
    ("DishSponge", 30, 1.0),
    ("Spoon", 30, 1.0),
    ("LightSwitch", 30, 1.0),
    ("Mug", 30, 1.0),
    ("Faucet", 30, 1.07),
    ("Drawer", 28, 6.21),
    ("Window", 26, 1.38),
    ("DiningTable", 16, 1.31),
    ("Kettle", 15, 1.0),
    ("Stool", 14, 1.36),
    ("Chair", 12, 1.67),
    ("HousePlant", 10, 1.1),
    ("WineBottle", 10, 1.0),
    ("PaperTowelRoll", 10, 1.0),
    ("Ladle", 10, 1.1),
    ("Shelf", 9, 3.0),
    ("Bottle", 7, 1.0),
    ("Vase", 6, 2.67),
    ("ShelvingUnit", 5, 1.0),
    ("Blinds", 5, 1.0),
    ("Statue", 4, 1.25),
    ("CellPhone", 4, 1.0),
    ("CreditCard", 3, 1.0),
    ("SideTable", 3, 1.0),
    ("GarbageBag", 3, 1.0),
    ("Book", 2, 1.0),
    ("Pen", 2, 1.0),
    ("SprayBottle", 2, 1.0),
    ("Curtains", 2, 1.0),
    ("Pencil", 2, 1.0),
    ("Mirror", 2, 1.0),
    ("Safe", 1, 1.0),
    ("AluminumFoil", 1, 3.0),
];

/// Share of the kitchens that have a category, and how many those have on average; 0 of what iTHOR does not have.
pub(crate) fn share_and_mean(category: &str) -> (f32, f32) {
    CATEGORIES
        .iter()
        .find(|(name, ..)| *name == category)
        .map_or((0.0, 0.0), |&(_, kitchens, mean)| (kitchens as f32 / KITCHENS, mean))
}
