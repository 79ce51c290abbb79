//! Which kitchen is generated: one of the 29, or one of those without end, which has a seed besides its number.

use proto::kitchen::KitchenId;
use proto::random::{Key, Purpose};

/// Kitchens that share iTHOR's distributions out among them.
pub(super) const SET: u32 = 29;
/// Draws about a whole set have this episode number in their key; those within one kitchen have 0.
const WHOLE_SET: u32 = 1;

/// A kitchen that the generator is asked for.
///
/// The 29 are one set. Procedural kitchens belong to sets of 29 consecutive numbers. As first drawn, each set shares out
/// iTHOR's quotas; a kitchen whose place holds more than fits takes another one. So each kitchen can still be generated
/// alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct KitchenKey {
    id: KitchenId,
    seed: u64,
    /// How often its place among the set was drawn before: what it was to hold found no room.
    edition: u32,
}

impl KitchenKey {
    /// The kitchen with this number; `seed` matters to procedural ones alone.
    pub fn new(id: KitchenId, seed: u64) -> Self {
        Self { id, seed: if id.is_procedural() { seed } else { 0 }, edition: 0 }
    }

    pub fn id(self) -> KitchenId {
        self.id
    }

    /// Its seed; 0 of a built-in kitchen.
    pub fn seed(self) -> u64 {
        self.seed
    }

    /// The same at this place of its set's order.
    pub(super) fn edition(self, edition: u32) -> Self {
        Self { edition, ..self }
    }

    /// Everyone of its set, itself as it is, others as they were drawn first.
    pub(super) fn set(self) -> Vec<Self> {
        let others: Vec<KitchenId> = if self.id.is_procedural() {
            let first = self.id.number() - (self.id.number() - KitchenId::FIRST_PROCEDURAL) % SET;
            (first..first + SET).filter_map(|number| KitchenId::new(number).ok()).collect()
        } else {
            KitchenId::all().collect()
        };
        others.into_iter().map(|id| if id == self.id { self } else { Self { id, edition: 0, ..self } }).collect()
    }

    /// Key of the draws of its room, for the `attempt`th time.
    pub(super) fn room(self, attempt: u32) -> Key {
        self.key(attempt, 0)
    }

    /// Key of its place in the order of its set that belongs to `question`.
    pub(super) fn place(self, question: u32) -> Key {
        Key { step: self.edition, ..self.key(question, WHOLE_SET) }
    }

    /// Key of its place within that place.
    pub(super) fn within(self, question: u32) -> Key {
        Key { step: self.edition, ..self.key(question, WHOLE_SET + 1) }
    }

    fn key(self, environment: u32, episode: u32) -> Key {
        Key { seed: self.seed, purpose: Purpose::Kitchen, kitchen: self.id.number(), environment, episode, step: 0 }
    }
}

impl From<KitchenId> for KitchenKey {
    fn from(id: KitchenId) -> Self {
        Self::new(id, 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kitchen_is_of_a_set_of_29() {
        for number in [1, 30, 1000, 1028, 1029, 5000] {
            let kitchen_key = KitchenKey::new(KitchenId::new(number).unwrap(), 7);
            let set = kitchen_key.set();
            assert_eq!((set.len(), set.contains(&kitchen_key)), (29, true), "{number}");
            assert!(set.iter().all(|other| other.seed() == kitchen_key.seed() && other.set() == set), "{number}");
            assert_eq!(kitchen_key.seed(), if number < 1000 { 0 } else { 7 });
        }
        let last = KitchenKey::from(KitchenId::new(1028).unwrap()).set();
        assert_eq!((last[0].id().number(), last[28].id().number()), (1000, 1028));
        let anew = KitchenKey::from(KitchenId::new(1003).unwrap()).edition(2);
        assert!(anew.set().contains(&anew) && anew.place(1) != anew.edition(1).place(1));
    }
}
