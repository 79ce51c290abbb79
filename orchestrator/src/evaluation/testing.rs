//! Records and events for tests.

use proto::config::Config;
use proto::evaluation::{Conditions, Distribution, EpisodeRecord, ObjectSet, category_of};
use proto::event::LearnerEvent;
use proto::kitchen::{KitchenId, Split};
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

/// Those of one fixed episode in each kitchen of a split, under this configuration.
pub fn conditions(config: &Config, split: Split, objects: ObjectSet) -> Conditions {
    Conditions {
        split,
        procedural: None,
        scenes: Vec::new(),
        objects,
        episodes: 1,
        distribution: Distribution::Fixed,
        start_distance_max_m: 0.0,
        goal_distance_max_m: 0.0,
        deterministic: false,
        seed: config.seed,
        max_steps: config.episode.max_steps,
        action_space: config.episode.action_space,
        actors: 5,
        environments_per_actor: 1,
        device: "cpu".into(),
    }
}
