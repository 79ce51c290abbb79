//! What took long to find about a procedural kitchen, as bytes: which draw has nothing wrong, where its things came to
//! rest, and where episodes can begin and end. Everything else follows from the number and the seed within milliseconds.
//!
//! ```text
//! magic and version, 8 bytes
//! number, seed, time step, attempt, connected share of the floor
//! things: each its category, its pose at rest
//! robot poses as bits, one byte a cell of the floor
//! places of each target as bits, one bit a point of the grid over the surfaces
//! XXH3 of all this, 8 bytes
//! ```
//!
//! Numbers are little-endian; lists begin with their length. A kitchen is always made from this, whether it was just
//! found or found long ago: so it does not matter to a single bit which of the two it was.

use super::catalogue::{CATEGORIES, pattern};
use super::draw::{ATTEMPTS_EACH, draw_fitted};
use super::generate::{DrawnRoom, EDITIONS, KitchenError};
use super::kitchen_key::KitchenKey;
use super::room::Thing;
use super::settled::{Kitchen, Target};
use super::spots;
use proto::config::SimulationConfig;
use proto::kitchen::{KitchenId, TargetCategory};
use rapier3d::math::{Pose3, Rot3, Vec3};
use xxhash_rust::xxh3::xxh3_64;

/// What a file begins with. The last byte is the version: raise it with every change of the generator.
const MAGIC: [u8; 8] = *b"STILLRK\x01";
const FARTHEST_M: f32 = 100.0;
const THINGS_MOST: usize = 1000;

#[derive(Debug, Clone, PartialEq)]
pub struct FoundKitchen {
    kitchen_key: KitchenKey,
    timestep_s: f32,
    attempt: u32,
    connected_share: f32,
    /// Index of its category, and where it rests.
    things: Vec<(u16, Pose3)>,
    stands: Vec<u8>,
    spots: Vec<Vec<u8>>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub(crate) enum FoundKitchenError {
    #[error("it was made by another version, or is no kitchen")]
    Version,
    #[error("its checksum does not agree with it")]
    Checksum,
    #[error("it holds numbers that no kitchen has")]
    Impossible,
    #[error("it is another kitchen's")]
    Other,
}

impl FoundKitchen {
    /// Finds a kitchen: draws rooms and lets them settle until nothing is wrong.
    pub fn make(kitchen_key: KitchenKey, simulation: &SimulationConfig) -> Result<Self, KitchenError> {
        let kitchen = Kitchen::search(kitchen_key, *simulation)?;
        let unfit =
            || KitchenError::FoundKitchen { kitchen: kitchen_key.id(), problem: "it cannot be kept".to_owned() };
        let poses = &kitchen.settled_poses[kitchen.movable_bodies()];
        let things = kitchen.bodies[kitchen.movable_bodies()].iter().zip(poses).map(|(body, pose)| {
            let category = CATEGORIES.iter().position(|category| category.name == body.category)?;
            Some((u16::try_from(category).ok()?, *pose))
        });
        let spots = TargetCategory::ALL.into_iter().map(|category| {
            let solid = &kitchen.solids[kitchen.target_movable(category)];
            spots::spots_as_bits(&kitchen.surfaces, solid, kitchen.target_spots(category))
        });
        Ok(Self {
            kitchen_key,
            timestep_s: simulation.timestep_s,
            attempt: kitchen.attempt,
            connected_share: kitchen.connected_share,
            things: things.collect::<Option<_>>().ok_or_else(unfit)?,
            stands: spots::stands_as_bits(kitchen.floor, &kitchen.stands).ok_or_else(unfit)?,
            spots: spots.collect::<Option<_>>().ok_or_else(unfit)?,
        })
    }

    pub fn open(&self) -> Result<Kitchen, KitchenError> {
        let id = self.kitchen_key.id();
        let unfit = |problem: String| KitchenError::FoundKitchen { kitchen: id, problem };
        let (fitted, _) = draw_fitted(self.kitchen_key, self.attempt).map_err(unfit)?;
        let things = self.things.iter().map(|&(category, pose)| Some(Thing::of(pattern(usize::from(category))?, pose)));
        let things: Option<Vec<Thing>> = things.collect();
        let things = things.ok_or_else(|| unfit("there is no such category".to_owned()))?;
        let DrawnRoom { room, plan, kept_clear } = DrawnRoom::of(fitted, things);
        let mut complete = true;
        let kitchen = Kitchen::reassemble(
            id,
            self.timestep_s,
            room,
            self.connected_share,
            |surfaces, floor, solids, movables| {
                let stands = spots::stands_of_bits(floor, &self.stands);
                let targets = TargetCategory::ALL.into_iter().zip(&self.spots).map(|(category, bits)| {
                    let movable = movables.iter().position(|body| body.category == category.name())?;
                    let spots = spots::spots_of_bits(surfaces, &solids[movable], bits)?;
                    Some(Target { movable, spots })
                });
                let targets: Vec<Option<Target>> = targets.collect();
                complete = stands.is_some() && targets.iter().all(Option::is_some);
                (stands.unwrap_or_default(), targets)
            },
        );
        if !complete {
            return Err(unfit("its places lie on another grid".to_owned()));
        }
        Ok(Kitchen { plan: Some(plan), kept_clear, attempt: self.attempt, ..kitchen })
    }

    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        let mut word = |word: u32| bytes.extend_from_slice(&word.to_le_bytes());
        word(self.kitchen_key.id().number());
        word(self.kitchen_key.seed() as u32);
        word((self.kitchen_key.seed() >> 32) as u32);
        word(self.timestep_s.to_bits());
        word(self.attempt);
        word(self.connected_share.to_bits());
        word(self.things.len() as u32);
        for (category, pose) in &self.things {
            word(u32::from(*category));
            let numbers = pose.translation.to_array().into_iter().chain(pose.rotation.to_array());
            numbers.for_each(|number| word(number.to_bits()));
        }
        for bits in std::iter::once(&self.stands).chain(&self.spots) {
            bytes.extend_from_slice(&(bits.len() as u32).to_le_bytes());
            bytes.extend_from_slice(bits);
        }
        let checksum = xxh3_64(&bytes);
        bytes.extend_from_slice(&checksum.to_le_bytes());
        bytes
    }

    /// The kitchen `kitchen_key`, with this time step, of bytes that [`FoundKitchen::to_bytes`] made.
    pub(crate) fn from_bytes(
        bytes: &[u8],
        kitchen_key: KitchenKey,
        simulation: SimulationConfig,
    ) -> Result<Self, FoundKitchenError> {
        if bytes.get(..MAGIC.len()) != Some(&MAGIC) {
            return Err(FoundKitchenError::Version);
        }
        let (content, checksum) = bytes.split_last_chunk::<8>().ok_or(FoundKitchenError::Checksum)?;
        if xxh3_64(content) != u64::from_le_bytes(*checksum) {
            return Err(FoundKitchenError::Checksum);
        }
        let mut rest = Bytes(&content[MAGIC.len()..]);
        let found = rest.found().filter(|_| rest.0.is_empty()).ok_or(FoundKitchenError::Checksum)?;
        let same = found.kitchen_key == kitchen_key && found.timestep_s.to_bits() == simulation.timestep_s.to_bits();
        if !same {
            return Err(FoundKitchenError::Other);
        }
        if found.is_possible() { Ok(found) } else { Err(FoundKitchenError::Impossible) }
    }

    /// Whether a search can have found it. Whoever can write the bytes can write their checksum, too, and physics that
    /// begins with a number that is none ends in a panic.
    fn is_possible(&self) -> bool {
        let rests = |pose: &Pose3| {
            let turn = pose.rotation.to_array().into_iter().map(|part| part * part).sum::<f32>();
            pose.translation.is_finite()
                && pose.translation.abs().max_element() <= FARTHEST_M
                && (turn - 1.0).abs() < 1e-3
        };
        self.attempt < ATTEMPTS_EACH * EDITIONS
            && (0.0..=1.0).contains(&self.connected_share)
            && self.things.len() <= THINGS_MOST
            && self.things.iter().all(|(_, pose)| rests(pose))
    }
}

impl Kitchen {
    /// Generates the kitchen with this number and lets it settle; a procedural one with seed 0.
    pub fn build(id: KitchenId, simulation: &SimulationConfig) -> Result<Self, KitchenError> {
        Self::generate(KitchenKey::from(id), simulation)
    }

    /// Generates a kitchen and lets it settle. A procedural one is then made from its [`FoundKitchen`], as it is
    /// wherever one is at hand: there is one way into it.
    pub fn generate(kitchen_key: KitchenKey, simulation: &SimulationConfig) -> Result<Self, KitchenError> {
        if kitchen_key.id().is_procedural() {
            FoundKitchen::make(kitchen_key, simulation)?.open()
        } else {
            Self::search(kitchen_key, *simulation)
        }
    }
}

struct Bytes<'a>(&'a [u8]);

impl Bytes<'_> {
    fn found(&mut self) -> Option<FoundKitchen> {
        let id = KitchenId::new(self.word()?).ok()?;
        let seed = u64::from(self.word()?) | u64::from(self.word()?) << 32;
        let (timestep_s, attempt, connected_share) = (self.number()?, self.word()?, self.number()?);
        let count = self.word()?;
        let things =
            (0..count).map(|_| Some((u16::try_from(self.word()?).ok()?, self.pose()?))).collect::<Option<_>>()?;
        let stands = self.bits()?;
        let spots = TargetCategory::ALL.map(|_| self.bits()).into_iter().collect::<Option<_>>()?;
        Some(FoundKitchen {
            kitchen_key: KitchenKey::new(id, seed),
            timestep_s,
            attempt,
            connected_share,
            things,
            stands,
            spots,
        })
    }

    fn word(&mut self) -> Option<u32> {
        let (word, rest) = self.0.split_first_chunk::<4>()?;
        self.0 = rest;
        Some(u32::from_le_bytes(*word))
    }

    fn number(&mut self) -> Option<f32> {
        self.word().map(f32::from_bits)
    }

    fn pose(&mut self) -> Option<Pose3> {
        let translation = Vec3::new(self.number()?, self.number()?, self.number()?);
        let rotation = Rot3::from_xyzw(self.number()?, self.number()?, self.number()?, self.number()?);
        Some(Pose3::from_parts(translation, rotation))
    }

    fn bits(&mut self) -> Option<Vec<u8>> {
        let count = self.word()? as usize;
        let (bits, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(bits.to_vec())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_kitchen_is_the_same_from_its_bytes() {
        let simulation = SimulationConfig::default();
        let kitchen_key = KitchenKey::new(KitchenId::new(1003).unwrap(), 0);
        let made = FoundKitchen::make(kitchen_key, &simulation).unwrap();
        let bytes = made.to_bytes();
        assert!(bytes.len() < 64_000, "{} bytes", bytes.len());
        let (_, hash) = bytes.split_last_chunk::<8>().unwrap();
        let known = (1, 13919610517797122427);
        assert_eq!((MAGIC[7], u64::from_le_bytes(*hash)), known, "the generator makes others: raise the version");
        let read = FoundKitchen::from_bytes(&bytes, kitchen_key, simulation).unwrap();
        assert_eq!(read, made);
        // Nothing was lost on the way: robot poses and places are those that were found.
        let (found, opened) = (Kitchen::search(kitchen_key, simulation).unwrap(), read.open().unwrap());
        assert_eq!(opened.robot_stands(), found.robot_stands());
        for category in TargetCategory::ALL {
            assert_eq!(opened.target_spots(category), found.target_spots(category));
        }
        for (index, (then, now)) in found.settled_poses().iter().zip(opened.settled_poses()).enumerate() {
            let moved_m = (then.translation - now.translation).length();
            assert!(moved_m < 1e-3, "body {index} crept by {moved_m} m");
        }
        assert_eq!(opened.settled_poses(), Kitchen::generate(kitchen_key, &simulation).unwrap().settled_poses());

        // Another one's, another time step's, and every damaged one is refused.
        let other = KitchenKey::new(KitchenId::new(1004).unwrap(), 0);
        assert_eq!(FoundKitchen::from_bytes(&bytes, other, simulation), Err(FoundKitchenError::Other));
        let seeded = KitchenKey::new(kitchen_key.id(), 1);
        assert_eq!(FoundKitchen::from_bytes(&bytes, seeded, simulation), Err(FoundKitchenError::Other));
        let finer = SimulationConfig { timestep_s: 1.0 / 120.0, ..simulation };
        assert_eq!(FoundKitchen::from_bytes(&bytes, kitchen_key, finer), Err(FoundKitchenError::Other));
        for at in (8..bytes.len()).step_by(97) {
            let mut damaged = bytes.clone();
            damaged[at] ^= 1;
            assert_eq!(
                FoundKitchen::from_bytes(&damaged, kitchen_key, simulation),
                Err(FoundKitchenError::Checksum),
                "byte {at}"
            );
            assert_eq!(
                FoundKitchen::from_bytes(&bytes[..at], kitchen_key, simulation),
                Err(FoundKitchenError::Checksum)
            );
        }
        assert_eq!(FoundKitchen::from_bytes(b"", kitchen_key, simulation), Err(FoundKitchenError::Version));
    }

    /// Somebody else's run folder brings its kitchens along, with checksums that agree.
    #[test]
    fn numbers_that_no_kitchen_has_are_refused() {
        let simulation = SimulationConfig::default();
        let kitchen_key = KitchenKey::new(KitchenId::new(1003).unwrap(), 0);
        let pose = Pose3::from_parts(Vec3::new(1.0, 0.5, 2.0), Rot3::IDENTITY);
        let sound = FoundKitchen {
            kitchen_key,
            timestep_s: simulation.timestep_s,
            attempt: 3,
            connected_share: 0.9,
            things: vec![(0, pose)],
            stands: vec![],
            spots: vec![vec![]; TargetCategory::ALL.len()],
        };
        let read = |found: &FoundKitchen| FoundKitchen::from_bytes(&found.to_bytes(), kitchen_key, simulation);
        assert_eq!(read(&sound).as_ref(), Ok(&sound));
        let with_pose = |pose| FoundKitchen { things: vec![(0, pose)], ..sound.clone() };
        for (what, wrong) in [
            ("attempt", FoundKitchen { attempt: u32::MAX, ..sound.clone() }),
            ("share", FoundKitchen { connected_share: 1.5, ..sound.clone() }),
            ("no share", FoundKitchen { connected_share: f32::NAN, ..sound.clone() }),
            ("too many", FoundKitchen { things: vec![(0, pose); THINGS_MOST + 1], ..sound.clone() }),
            ("nowhere", with_pose(Pose3::from_parts(Vec3::new(0.0, f32::NAN, 0.0), Rot3::IDENTITY))),
            ("far", with_pose(Pose3::from_parts(Vec3::new(1e30, 0.0, 0.0), Rot3::IDENTITY))),
            ("no turn", with_pose(Pose3::from_parts(Vec3::ZERO, Rot3::from_xyzw(0.0, 0.0, 0.0, 0.0)))),
            ("endless turn", with_pose(Pose3::from_parts(Vec3::ZERO, Rot3::from_xyzw(0.0, f32::INFINITY, 0.0, 1.0)))),
        ] {
            assert_eq!(read(&wrong), Err(FoundKitchenError::Impossible), "{what}");
        }
    }
}
