//! Kitchen numbers, the splits they fall into, and the target categories (SPEC section 1).

use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// Number of one kitchen: 1..=30 without 28, as in iTHOR.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "u8", into = "u8")]
pub struct KitchenId(u8);

/// A number that names no kitchen.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error("there is no kitchen {0}: kitchens are numbered 1 to 30, without 28")]
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
    /// The kitchen with this number.
    pub fn new(number: u8) -> Result<Self, NoSuchKitchen> {
        if (1..=30).contains(&number) && number != 28 { Ok(Self(number)) } else { Err(NoSuchKitchen(number)) }
    }

    /// Its number.
    pub fn number(self) -> u8 {
        self.0
    }

    /// All 29 kitchens in ascending order.
    pub fn all() -> impl Iterator<Item = Self> {
        (1..=30).filter_map(|number| Self::new(number).ok())
    }

    /// The kitchens of a split in ascending order.
    pub fn of_split(split: Split) -> Vec<Self> {
        Self::all().filter(|kitchen| kitchen.split() == split).collect()
    }

    /// The split this kitchen belongs to: i % 3 in {0, 1} train, i % 6 = 2 test, i % 6 = 5 validation.
    pub fn split(self) -> Split {
        match self.0 % 6 {
            2 => Split::Test,
            5 => Split::Validation,
            _ => Split::Train,
        }
    }

    /// The kitchen that actor number `actor` simulates: training kitchens in order, repeating after the last.
    pub fn of_actor(actor: u32) -> Self {
        let train = Self::of_split(Split::Train);
        train[actor as usize % train.len()]
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
            KitchenId::new(number).map_err(|error| error.to_string())
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
    pub const NOVEL: [Self; 6] = [Self::Potato, Self::SoapBottle, Self::Pan, Self::Egg, Self::Spatula, Self::Cup];
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
        assert_eq!(KitchenId::of_split(Split::Train).len(), 19);
        assert_eq!(KitchenId::of_split(Split::Test).len(), 5);
        assert_eq!(KitchenId::of_split(Split::Validation).len(), 5);
        assert_eq!(KitchenId::new(28), Err(NoSuchKitchen(28)));
        assert_eq!(KitchenId::of_actor(0).number(), 1);
        assert_eq!(KitchenId::of_actor(19), KitchenId::of_actor(0));
    }

    #[test]
    fn categories_are_numbered_in_order() {
        for (i, category) in TargetCategory::ALL.iter().enumerate() {
            assert_eq!(usize::from(category.index()), i);
        }
    }
}
