//! The fixed episodes of the validation and test kitchens, as they lie in the program.
//!
//! Episodes name places by number, which mean nothing in another room: each kitchen's section of the file carries the
//! fingerprint of the kitchen it was drawn for.

use super::format::{File, FormatError, Record};
use crate::kitchen::Kitchen;
use crate::tasks::arm_point_nav::episode::Episode;
use proto::kitchen::{KitchenId, Split, TargetCategory};
use std::sync::OnceLock;
use xxhash_rust::xxh3::{Xxh3, xxh3_64};

/// XXH3 (64 bits) of the file: a file of other episodes is noticed before a figure is compared with an older one.
pub const FILE_HASH: u64 = 0x97fb_f224_55a4_1711;
/// The file, as `actor episodes generate` wrote it.
static FILE: &[u8] = include_bytes!("fixed.bin");

#[derive(Debug, Clone, thiserror::Error, PartialEq, Eq)]
pub enum EpisodesError {
    #[error("the file of fixed episodes has hash {found:#018x}, not {FILE_HASH:#018x}")]
    WrongFile { found: u64 },
    #[error("the file of fixed episodes: {0}")]
    Format(#[from] FormatError),
    #[error("kitchen {0} has no fixed episodes: only validation and test kitchens do")]
    NotFixed(KitchenId),
    #[error(
        "the fixed episodes were drawn for another kitchen {kitchen} (fingerprint {drawn_for:#018x}, now \
         {found:#018x}): `actor episodes generate` draws new ones"
    )]
    OtherKitchen { kitchen: KitchenId, drawn_for: u64, found: u64 },
    #[error("kitchen {kitchen} has no place for the target {target}, which the evaluation asks for")]
    NoTarget { kitchen: KitchenId, target: &'static str },
    #[error("episode {episode} of kitchen {kitchen} names a place that is not there")]
    NoSuchPlace { kitchen: KitchenId, episode: usize },
}

/// Kitchens that have fixed episodes, in the file's order.
pub fn kitchens() -> Vec<KitchenId> {
    KitchenId::all().filter(|kitchen| kitchen.split() != Split::Train).collect()
}

/// The fixed episodes of a kitchen. Categories take turns, so that the first 12 have each of them once.
pub fn fixed(kitchen: &Kitchen) -> Result<Vec<Episode>, EpisodesError> {
    static PARSED: OnceLock<Result<File, FormatError>> = OnceLock::new();
    let found = xxh3_64(FILE);
    if found != FILE_HASH {
        return Err(EpisodesError::WrongFile { found });
    }
    let file = PARSED.get_or_init(|| File::parse(FILE)).as_ref().map_err(Clone::clone)?;
    of_file(file, kitchen)
}

/// A file's episodes of a kitchen that looks as it did when they were drawn.
fn of_file(file: &File, kitchen: &Kitchen) -> Result<Vec<Episode>, EpisodesError> {
    let id = kitchen.id();
    let section = file.sections.iter().find(|section| section.kitchen == id);
    let section = section.ok_or(EpisodesError::NotFixed(id))?;
    let found = fingerprint(kitchen);
    if found != section.fingerprint {
        return Err(EpisodesError::OtherKitchen { kitchen: id, drawn_for: section.fingerprint, found });
    }
    let episodes = section.records.iter().enumerate().map(|(number, record)| {
        episode_of(*record, kitchen, number).ok_or(EpisodesError::NoSuchPlace { kitchen: id, episode: number })
    });
    episodes.collect()
}

/// The episode that a record with this number means in a kitchen; none if a place is not there.
pub fn episode_of(record: Record, kitchen: &Kitchen, number: usize) -> Option<Episode> {
    let category = category(number);
    let spots = kitchen.target_spots(category);
    Some(Episode {
        category,
        start: *spots.get(usize::from(record.start))?,
        goal: *spots.get(usize::from(record.goal))?,
        stand: *kitchen.robot_stands().get(usize::from(record.stand))?,
    })
}

pub fn category(episode: usize) -> TargetCategory {
    proto::evaluation::category_of(episode as u32)
}

/// Hash of what episodes refer to: where everything stands, where targets can stand, where the robot can start.
pub fn fingerprint(kitchen: &Kitchen) -> u64 {
    let mut hash = Xxh3::new();
    for body in kitchen.bodies() {
        hash.update(body.name.as_bytes());
        hash.update(&[0]);
    }
    let mut floats = |values: &[f32]| values.iter().for_each(|value| hash.update(&value.to_bits().to_le_bytes()));
    for pose in kitchen.settled_poses() {
        floats(&pose.translation.to_array());
        floats(&pose.rotation.to_array());
    }
    for category in TargetCategory::ALL {
        floats(&[kitchen.target_spots(category).len() as f32]);
        kitchen.target_spots(category).iter().for_each(|spot| floats(&spot.to_array()));
    }
    for stand in kitchen.robot_stands() {
        floats(&[stand.x_m, stand.z_m, stand.yaw_ticks as f32]);
    }
    hash.digest()
}
