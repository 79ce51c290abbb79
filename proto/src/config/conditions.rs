//! What an evaluation takes of a run's configuration.

use super::Config;
use crate::evaluation::{Conditions, Distribution, EvaluationConfig};

impl EvaluationConfig {
    /// Of start and target, and of goal and target, metres; 0 = anywhere in the kitchen.
    pub fn distances_max_m(&self, config: &Config) -> [f32; 2] {
        match self.distribution {
            Distribution::Fixed | Distribution::Seeds => [0.0; 2],
            Distribution::Run => [config.episode.start_distance_max_m, config.episode.goal_distance_max_m],
        }
    }
}

impl Conditions {
    pub fn of(config: &Config, asked: &EvaluationConfig, device: String) -> Self {
        let [start_distance_max_m, goal_distance_max_m] = asked.distances_max_m(config);
        Self {
            split: asked.split,
            procedural: asked.procedural,
            scenes: config.scenes.clone(),
            objects: asked.objects,
            episodes: asked.episodes,
            distribution: asked.distribution,
            start_distance_max_m,
            goal_distance_max_m,
            deterministic: asked.deterministic,
            seed: config.seed,
            max_steps: config.episode.max_steps,
            action_space: config.episode.action_space,
            actors: config.actors.count,
            environments_per_actor: config.actors.environments_per_actor,
            device,
        }
    }
}
