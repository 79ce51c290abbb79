//! A record for tests.

use proto::evaluation::{EpisodeEnd, EpisodeRecord, category_of};
use proto::kitchen::KitchenId;

/// An episode of one step that came to nothing.
pub fn uneventful(kitchen: KitchenId, episode: u32) -> EpisodeRecord {
    EpisodeRecord {
        kitchen,
        episode,
        category: category_of(episode),
        end: EpisodeEnd::Done,
        success: false,
        picked_up: false,
        pickup_step: None,
        length: 1,
        failed_actions: 0,
        return_r: 0.0,
        return_r_prime: 0.0,
        disturbance_m: 0.0,
        peak_disturbance_m: 0.0,
        disturbed_objects: 0,
        ever_disturbed_objects: 0,
        farthest_m: 0.0,
        peak_farthest_m: 0.0,
        disturbing_steps: Some(0),
        displaced_steps: Some(0),
        wrist_object_m: 0.0,
        object_goal_m: 0.0,
        disturb_prediction: None,
        state_hash: 0,
    }
}
