//! Kitchen numbers, their splits, and the target categories (`docs/method.md`, Task).

use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// Number of one kitchen: 1..=30 without 28, as in iTHOR; [`KitchenId::FIRST_SCENE`] and up for the scenes that a
/// run's configuration names, in their order; [`KitchenId::FIRST_PROCEDURAL`] and up for kitchens without end, which
/// are drawn from their number and a seed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "u32", into = "u32")]
pub struct KitchenId(u32);

#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error(
    "there is no kitchen {0}: kitchens are numbered 1 to 30, without 28 (scenes of a run: 128 to 255; procedural \
     kitchens: 1000 to 9999999)"
)]
pub struct NoSuchKitchen(pub u32);

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
    pub(crate) const FIRST_SCENE: u32 = 128;
    pub const SCENES_MAX: usize = 128;
    pub const FIRST_PROCEDURAL: u32 = 1000;
    pub const LAST_PROCEDURAL: u32 = 9_999_999;

    pub fn new(number: u32) -> Result<Self, NoSuchKitchen> {
        let (built_in, kitchen) = ((1..=30).contains(&number) && number != 28, Self(number));
        let known = built_in || kitchen.scene_index().is_some() || kitchen.is_procedural();
        if known { Ok(kitchen) } else { Err(NoSuchKitchen(number)) }
    }

    pub fn built_in(number: u32) -> Result<Self, NoSuchKitchen> {
        Self::new(number)
            .and_then(|kitchen| if kitchen.is_built_in() { Ok(kitchen) } else { Err(NoSuchKitchen(number)) })
    }

    /// The kitchen with this number, if a generator makes it: a built-in or a procedural one.
    pub fn generated(number: u32) -> Result<Self, NoSuchKitchen> {
        Self::new(number).and_then(|kitchen| match kitchen.scene_index() {
            None => Ok(kitchen),
            Some(_) => Err(NoSuchKitchen(number)),
        })
    }

    /// The run's scene at this place of its list; none beyond [`KitchenId::SCENES_MAX`].
    pub fn scene(index: usize) -> Option<Self> {
        (index < Self::SCENES_MAX).then(|| Self(Self::FIRST_SCENE + index as u32))
    }

    /// Its place in the run's list of scenes; none if it is no scene.
    pub fn scene_index(self) -> Option<usize> {
        let index = self.0.checked_sub(Self::FIRST_SCENE)? as usize;
        (index < Self::SCENES_MAX).then_some(index)
    }

    /// Whether it is one of the kitchens without end.
    pub fn is_procedural(self) -> bool {
        (Self::FIRST_PROCEDURAL..=Self::LAST_PROCEDURAL).contains(&self.0)
    }

    /// Whether it is one of the 29.
    pub fn is_built_in(self) -> bool {
        self.scene_index().is_none() && !self.is_procedural()
    }

    pub fn number(self) -> u32 {
        self.0
    }

    pub fn all() -> impl Iterator<Item = Self> {
        (1..=30).filter_map(|number| Self::new(number).ok())
    }

    pub fn of_split(split: Split) -> Vec<Self> {
        Self::all().filter(|kitchen| kitchen.split() == split).collect()
    }

    /// The split this kitchen belongs to: i % 3 in {0, 1} train, i % 6 = 2 test, i % 6 = 5 validation; all but the 29
    /// train.
    pub fn split(self) -> Split {
        match self.0 % 6 {
            2 if self.is_built_in() => Split::Test,
            5 if self.is_built_in() => Split::Validation,
            _ => Split::Train,
        }
    }
}

/// Procedural kitchens with consecutive numbers, as people write them: `1000..1040`, without the last.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct KitchenRange {
    first: u32,
    end: u32,
}

impl KitchenRange {
    /// So many from the first procedural kitchen on; none if there are not so many, or none at all.
    pub fn first(count: u32) -> Option<Self> {
        Self::new(KitchenId::FIRST_PROCEDURAL, KitchenId::FIRST_PROCEDURAL.checked_add(count)?)
    }

    /// Those from `first` to before `end`; none if not all of them are procedural, or there are none.
    pub fn new(first: u32, end: u32) -> Option<Self> {
        let whole = first >= KitchenId::FIRST_PROCEDURAL && end <= KitchenId::LAST_PROCEDURAL + 1;
        (whole && first < end).then_some(Self { first, end })
    }

    pub(crate) fn first_id(self) -> KitchenId {
        KitchenId(self.first)
    }

    pub fn count(self) -> u32 {
        self.end - self.first
    }

    /// The one at this place from 0; none beyond the last.
    pub fn get(self, index: u32) -> Option<KitchenId> {
        (index < self.count()).then(|| KitchenId(self.first + index))
    }

    pub fn ids(self) -> impl Iterator<Item = KitchenId> {
        (self.first..self.end).map(KitchenId)
    }
}

impl FromStr for KitchenRange {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let parsed =
            text.split_once("..").and_then(|(first, end)| Some((first.trim().parse().ok()?, end.trim().parse().ok()?)));
        parsed.and_then(|(first, end)| Self::new(first, end)).ok_or_else(|| {
            format!("`{text}` is no range of procedural kitchens: FIRST..END, from 1000 on and without END, as in 1000..1040")
        })
    }
}

impl TryFrom<String> for KitchenRange {
    type Error = String;
    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<KitchenRange> for String {
    fn from(range: KitchenRange) -> String {
        range.to_string()
    }
}

impl fmt::Display for KitchenRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}..{}", self.first, self.end)
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kitchens {
    Split(Split),
    /// A single built-in one: an evaluation that somebody watches.
    One(KitchenId),
    Scenes(usize),
    /// Procedural ones: every environment has one of its own, and another one later (`KitchenSchedule`).
    Procedural(KitchenRange),
    /// No kitchens: environments that are not built in. They are numbered as if all were in the first scene.
    Elsewhere,
}

impl Kitchens {
    pub const TRAINING: Self = Self::Split(Split::Train);

    pub fn ids(self) -> Vec<KitchenId> {
        match self {
            Self::Split(split) => KitchenId::of_split(split),
            Self::One(kitchen) => vec![kitchen],
            Self::Scenes(scenes) => (0..scenes).filter_map(KitchenId::scene).collect(),
            Self::Elsewhere => KitchenId::scene(0).into_iter().collect(),
            Self::Procedural(range) => range.ids().collect(),
        }
    }

    pub fn count(self) -> usize {
        match self {
            Self::Split(split) => KitchenId::all().filter(|kitchen| kitchen.split() == split).count(),
            Self::One(_) | Self::Elsewhere => 1,
            Self::Scenes(scenes) => scenes.min(KitchenId::SCENES_MAX),
            Self::Procedural(range) => range.count() as usize,
        }
    }

    /// The kitchen that all environments of actor number `actor` are in: actors take turns, and begin again after the
    /// last. None where every environment has its own.
    pub fn of_actor(self, actor: u32) -> Option<KitchenId> {
        if let Self::Procedural(_) | Self::Elsewhere = self {
            return None;
        }
        let kitchens = self.ids();
        Some(kitchens[actor as usize % kitchens.len()])
    }
}

impl TryFrom<u32> for KitchenId {
    type Error = NoSuchKitchen;
    fn try_from(number: u32) -> Result<Self, NoSuchKitchen> {
        Self::new(number)
    }
}

impl From<KitchenId> for u32 {
    fn from(kitchen: KitchenId) -> u32 {
        kitchen.0
    }
}

impl fmt::Display for KitchenId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0)
    }
}

/// Which kitchens a command is about, as a user writes it: `all` for the 29, numbers such as `1,2,5`, or ranges of
/// procedural ones such as `1000..1040`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KitchenChoice(pub Vec<KitchenId>);

impl FromStr for KitchenChoice {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        if text == "all" {
            return Ok(Self(KitchenId::all().collect()));
        }
        let mut kitchens = Vec::new();
        for word in text.split(',') {
            if word.contains("..") {
                kitchens.extend(word.parse::<KitchenRange>()?.ids());
                continue;
            }
            let number = word.trim().parse().map_err(|_| format!("`{word}` is not a kitchen number"))?;
            kitchens.push(KitchenId::generated(number).map_err(|error| error.to_string())?);
        }
        Ok(Self(kitchens))
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
    Apple = 0,
    Bread = 1,
    Tomato = 2,
    Lettuce = 3,
    Pot = 4,
    Mug = 5,
    Potato = 6,
    SoapBottle = 7,
    Pan = 8,
    Egg = 9,
    Spatula = 10,
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

    pub fn index(self) -> u8 {
        self as u8
    }

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
        assert_eq!(Kitchens::TRAINING.of_actor(0), KitchenId::new(1).ok());
        assert_eq!(Kitchens::TRAINING.of_actor(19), Kitchens::TRAINING.of_actor(0));
        let one = Kitchens::One(KitchenId::new(8).unwrap());
        assert_eq!((one.count(), one.of_actor(1)), (1, KitchenId::new(8).ok()));
    }

    #[test]
    fn scenes_take_the_place_of_the_training_kitchens() {
        let kitchens: Vec<u32> = (0..3).map(|actor| Kitchens::Scenes(2).of_actor(actor).unwrap().number()).collect();
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
    fn procedural_kitchens_are_a_range_of_their_own() {
        let range: KitchenRange = "1000..1040".parse().unwrap();
        assert_eq!((range.count(), Some(range)), (40, KitchenRange::first(40)));
        assert_eq!(range.get(39), KitchenId::new(1039).ok());
        assert_eq!((range.get(40), range.to_string().as_str()), (None, "1000..1040"));
        for wrong in ["1000", "999..1001", "1040..1000", "1000..1000", "5..x", "9999999..10000001"] {
            assert!(wrong.parse::<KitchenRange>().unwrap_err().contains("1000..1040"), "{wrong}");
        }
        let choice: KitchenChoice = "7,1000..1003,2000".parse().unwrap();
        assert_eq!(choice.0.iter().map(|kitchen| kitchen.number()).collect::<Vec<_>>(), [7, 1000, 1001, 1002, 2000]);
        assert!("128".parse::<KitchenChoice>().is_err() && "28".parse::<KitchenChoice>().is_err());
        let kitchen = KitchenId::new(1001).unwrap();
        assert_eq!((kitchen.split(), kitchen.scene_index(), kitchen.is_procedural()), (Split::Train, None, true));
        assert_eq!(Kitchens::Procedural(range).of_actor(3), None);
        assert_eq!([256, 999, 10_000_000].map(|number| KitchenId::new(number).is_ok()), [false; 3]);
    }

    #[test]
    fn categories_are_numbered_in_order() {
        for (i, category) in TargetCategory::ALL.iter().enumerate() {
            assert_eq!(usize::from(category.index()), i);
        }
    }
}
