//! Records and events for tests.

use proto::config::Config;
use proto::evaluation::{EpisodeRecord, category_of};
use proto::event::LearnerEvent;
use proto::kitchen::KitchenId;
use proto::record::End;

/// An episode of one step, of the default task; of its numbers these are 1, the others 0.
pub fn played(kitchen: KitchenId, episode: u32, ones: &[&str]) -> EpisodeRecord {
    let columns = Config::default().spec().columns();
    EpisodeRecord {
        kitchen,
        episode,
        category: Some(category_of(episode)),
        end: End::Terminated,
        length: 1,
        numbers: columns.iter().map(|one| Some(f64::from(u8::from(ones.contains(&one.name.as_str()))))).collect(),
        prediction: None,
        state_hash: 0,
    }
}

/// A learner without a checkpoint is ready.
pub fn ready(rank: u32, rollout: u64, frames: u64) -> LearnerEvent {
    let device = "cpu".to_owned();
    LearnerEvent::Ready { rank, rollout, frames, device, parameters: 1, checkpoint: None }
}
