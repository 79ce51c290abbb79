//! Draws the fixed episodes: the same for the same kitchens, for ever.

use crate::check::episode::{Problem, check};
use crate::parallel::in_parallel;
use anyhow::{Result, bail};
use proto::config::Config;
use proto::random::{Key, Purpose};
use simulator::kitchen::Kitchen;
use simulator::tasks::arm_point_nav::episodes::format::{Record, Section};
use simulator::tasks::arm_point_nav::episodes::{EPISODES_PER_KITCHEN, category, episode_of, fingerprint};
use std::sync::Arc;

const SEED: u64 = 0x5354_494c_4c52_4f4f;
const DRAWS: u32 = 400;

/// Draws all episodes of a kitchen; also returns what was wrong with the draws that were not valid.
pub fn draw(kitchen: &Arc<Kitchen>, config: &Config) -> Result<(Section, Vec<Problem>)> {
    let drawn = in_parallel(EPISODES_PER_KITCHEN, |episode| one(kitchen, config, episode));
    let mut records = Vec::with_capacity(EPISODES_PER_KITCHEN);
    let mut rejected = Vec::new();
    for record in drawn {
        let (record, problems) = record?;
        records.push(record);
        rejected.extend(problems);
    }
    Ok((Section { kitchen: kitchen.id(), fingerprint: fingerprint(kitchen), records }, rejected))
}

/// The first valid draw of an episode, and what was wrong with those before.
fn one(kitchen: &Arc<Kitchen>, config: &Config, episode: usize) -> Result<(Record, Vec<Problem>)> {
    let mut rejected = Vec::new();
    for attempt in 0..DRAWS {
        let key = Key {
            seed: SEED,
            purpose: Purpose::Episode,
            kitchen: kitchen.id().number(),
            environment: 0,
            episode: episode as u32,
            step: attempt,
        };
        let mut random = key.stream();
        // A file has 16 bits for each number: what lies beyond is never drawn.
        let mut below = |count: usize| random.below(count.min(usize::from(u16::MAX)) as u32) as u16;
        let spots = kitchen.target_spots(category(episode)).len();
        let record = Record { start: below(spots), goal: below(spots), stand: below(kitchen.robot_stands().len()) };
        let drawn = episode_of(record, kitchen, episode).expect("the numbers were drawn below the counts");
        match check(kitchen, config, &drawn) {
            Ok(()) => return Ok((record, rejected)),
            Err(problem) => rejected.push(problem),
        }
    }
    let last = rejected.last().map_or_else(String::new, ToString::to_string);
    bail!("kitchen {}, episode {episode}: none of {DRAWS} draws is valid; the last one: {last}", kitchen.id())
}
