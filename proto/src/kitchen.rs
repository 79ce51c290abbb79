//! Kitchen numbers, their splits, and the target categories (`docs/method.md`, Task).

use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// Number of one kitchen: 1..=30 without 28, as in iTHOR, or [`KitchenId::FIRST_SCENE`] and up for the scenes that a
/// run's configuration names, in their order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "u8", into = "u8")]
pub struct KitchenId(u8);

/// A number that names no kitchen.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error("there is no kitchen {0}: kitchens are numbered 1 to 30, without 28 (scenes of a run: 128 to 255)")]
pub struct NoSuchKitchen(pub u8);

/// What a kitchen is used for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Split {
    /// 19 kitchens with sampled episodes.
    Train,
    /// 5 kitchens with 720 fixed episodes each.
    Validation,
    /// 5 kitchens with 720 fixed episodes each.
    Test,
}

impl KitchenId {
    /// Number of a run's first scene.
    pub(crate) const FIRST_SCENE: u8 = 128;
    /// Scenes that one run can have.
    pub(crate) const SCENES_MAX: usize = 128;

    /// The kitchen with this number.
    pub fn new(number: u8) -> Result<Self, NoSuchKitchen> {
        let built_in = (1..=30).contains(&number) && number != 28;
        if built_in || number >= Self::FIRST_SCENE { Ok(Self(number)) } else { Err(NoSuchKitchen(number)) }
    }

    /// The built-in kitchen with this number.
    pub fn built_in(number: u8) -> Result<Self, NoSuchKitchen> {
        Self::new(number).and_then(|kitchen| match kitchen.scene_index() {
            None => Ok(kitchen),
            Some(_) => Err(NoSuchKitchen(number)),
        })
    }

    /// The run's scene at this place of its list; none beyond [`KitchenId::SCENES_MAX`].
    pub fn scene(index: usize) -> Option<Self> {
        let number = u8::try_from(index).ok()?.checked_add(Self::FIRST_SCENE)?;
        Some(Self(number))
    }

    /// Its place in the run's list of scenes; none if it is built in.
    pub fn scene_index(self) -> Option<usize> {
        self.0.checked_sub(Self::FIRST_SCENE).map(usize::from)
    }

    /// Its number.
    pub fn number(self) -> u8 {
        self.0
    }

    /// All 29 built-in kitchens in ascending order.
    pub fn all() -> impl Iterator<Item = Self> {
        (1..=30).filter_map(|number| Self::new(number).ok())
    }

    /// The kitchens of a split in ascending order.
    pub fn of_split(split: Split) -> Vec<Self> {
        Self::all().filter(|kitchen| kitchen.split() == split).collect()
    }

    /// The split this kitchen belongs to: i % 3 in {0, 1} train, i % 6 = 2 test, i % 6 = 5 validation; scenes train.
    pub fn split(self) -> Split {
        match self.0 % 6 {
            2 if self.scene_index().is_none() => Split::Test,
            5 if self.scene_index().is_none() => Split::Validation,
            _ => Split::Train,
        }
    }
}

/// The kitchens that a run's actors simulate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kitchens {
    /// Those of a split.
    Split(Split),
    /// This many scenes of the run's own.
    Scenes(usize),
}

impl Kitchens {
    /// The training kitchens.
    pub const TRAINING: Self = Self::Split(Split::Train);

    /// All of them, in order.
    pub fn ids(self) -> Vec<KitchenId> {
        match self {
            Self::Split(split) => KitchenId::of_split(split),
            Self::Scenes(scenes) => (0..scenes).filter_map(KitchenId::scene).collect(),
        }
    }

    /// How many there are.
    pub fn count(self) -> usize {
        match self {
            Self::Split(split) => KitchenId::all().filter(|kitchen| kitchen.split() == split).count(),
            Self::Scenes(scenes) => scenes.min(KitchenId::SCENES_MAX),
        }
    }

    /// The kitchen that actor number `actor` simulates: they take turns, and begin again after the last.
    pub fn of_actor(self, actor: u32) -> KitchenId {
        let kitchens = self.ids();
        kitchens[actor as usize % kitchens.len()]
    }
}

impl TryFrom<u8> for KitchenId {
    type Error = NoSuchKitchen;
    fn try_from(number: u8) -> Result<Self, NoSuchKitchen> {
        Self::new(number)
    }
}

impl From<KitchenId> for u8 {
    fn from(kitchen: KitchenId) -> u8 {
        kitchen.0
    }
}

impl fmt::Display for KitchenId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0)
    }
}

/// Which kitchens a command is about, as a user writes it: `all`, or numbers such as `1,2,5`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KitchenChoice(pub Vec<KitchenId>);

impl FromStr for KitchenChoice {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        if text == "all" {
            return Ok(Self(KitchenId::all().collect()));
        }
        let one = |word: &str| {
            let number = word.trim().parse().map_err(|_| format!("`{word}` is not a kitchen number"))?;
            KitchenId::built_in(number).map_err(|error| error.to_string())
        };
        text.split(',').map(one).collect::<Result<_, _>>().map(Self)
    }
}

impl fmt::Display for KitchenChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let numbers: Vec<String> = self.0.iter().map(ToString::to_string).collect();
        f.write_str(&numbers.join(","))
    }
}

/// A category that can be an episode's target. The discriminant is the wire value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[repr(u8)]
pub enum TargetCategory {
    /// Seen in training.
    Apple = 0,
    /// Seen in training.
    Bread = 1,
    /// Seen in training.
    Tomato = 2,
    /// Seen in training.
    Lettuce = 3,
    /// Seen in training.
    Pot = 4,
    /// Seen in training.
    Mug = 5,
    /// Novel: a target in evaluation only.
    Potato = 6,
    /// Novel: a target in evaluation only.
    SoapBottle = 7,
    /// Novel: a target in evaluation only.
    Pan = 8,
    /// Novel: a target in evaluation only.
    Egg = 9,
    /// Novel: a target in evaluation only.
    Spatula = 10,
    /// Novel: a target in evaluation only.
    Cup = 11,
}

impl TargetCategory {
    /// The six categories that are targets in training.
    pub const SEEN: [Self; 6] = [Self::Apple, Self::Bread, Self::Tomato, Self::Lettuce, Self::Pot, Self::Mug];
    /// The six categories that are targets in evaluation only.
    pub(crate) const NOVEL: [Self; 6] =
        [Self::Potato, Self::SoapBottle, Self::Pan, Self::Egg, Self::Spatula, Self::Cup];
    /// All twelve, in wire order.
    pub const ALL: [Self; 12] = [
        Self::Apple,
        Self::Bread,
        Self::Tomato,
        Self::Lettuce,
        Self::Pot,
        Self::Mug,
        Self::Potato,
        Self::SoapBottle,
        Self::Pan,
        Self::Egg,
        Self::Spatula,
        Self::Cup,
    ];

    /// The category with this wire value, if there is one.
    pub fn from_index(index: u8) -> Option<Self> {
        Self::ALL.get(usize::from(index)).copied()
    }

    /// The wire value.
    pub fn index(self) -> u8 {
        self as u8
    }

    /// iTHOR's name of the category.
    pub fn name(self) -> &'static str {
        match self {
            Self::Apple => "Apple",
            Self::Bread => "Bread",
            Self::Tomato => "Tomato",
            Self::Lettuce => "Lettuce",
            Self::Pot => "Pot",
            Self::Mug => "Mug",
            Self::Potato => "Potato",
            Self::SoapBottle => "SoapBottle",
            Self::Pan => "Pan",
            Self::Egg => "Egg",
            Self::Spatula => "Spatula",
            Self::Cup => "Cup",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn splits_have_the_sizes_of_the_paper() {
        assert_eq!(KitchenId::all().count(), 29);
        for (split, count) in [(Split::Train, 19), (Split::Test, 5), (Split::Validation, 5)] {
            assert_eq!((KitchenId::of_split(split).len(), Kitchens::Split(split).count()), (count, count));
        }
        assert!([0, 3, 128, 200].iter().all(|&n| Kitchens::Scenes(n).count() == Kitchens::Scenes(n).ids().len()));
        assert_eq!(KitchenId::new(28), Err(NoSuchKitchen(28)));
        assert_eq!(Kitchens::TRAINING.of_actor(0).number(), 1);
        assert_eq!(Kitchens::TRAINING.of_actor(19), Kitchens::TRAINING.of_actor(0));
    }

    #[test]
    fn scenes_take_the_place_of_the_training_kitchens() {
        let kitchens: Vec<u8> = (0..3).map(|actor| Kitchens::Scenes(2).of_actor(actor).number()).collect();
        assert_eq!(kitchens, [128, 129, 128]);
        for index in 0..KitchenId::SCENES_MAX {
            let scene = KitchenId::scene(index).unwrap();
            assert_eq!((scene.scene_index(), scene.split()), (Some(index), Split::Train));
            assert_eq!(KitchenId::new(scene.number()), Ok(scene));
            assert!(KitchenId::built_in(scene.number()).is_err());
        }
        assert_eq!(KitchenId::scene(KitchenId::SCENES_MAX), None);
        assert!(KitchenId::all().all(|kitchen| kitchen.scene_index().is_none()));
    }

    #[test]
    fn categories_are_numbered_in_order() {
        for (i, category) in TargetCategory::ALL.iter().enumerate() {
            assert_eq!(usize::from(category.index()), i);
        }
    }
}
