use crate::evaluation::Distribution;
use crate::kitchen::Split;
use crate::task::ActionSpace;
use serde::{Deserialize, Serialize};

/// What an episode is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EpisodeConfig {
    /// Horizon T: an episode ends after this many actions.
    pub max_steps: u32,
    /// Actions the policy may choose from: `large`, all of the task's, or a subset that it names.
    pub action_space: ActionSpace,
    /// Robot starts at most this far from the target on the floor plane, metres; 0 = anywhere in the kitchen.
    pub start_distance_max_m: f32,
    /// The goal is at most this far from where the way to it begins, metres: in `ArmPointNav` the target's start, in
    /// `PointNav` the robot's, along the floor. 0 = anywhere in the kitchen.
    pub goal_distance_max_m: f32,
}

impl Default for EpisodeConfig {
    fn default() -> Self {
        Self {
            max_steps: 200,
            action_space: ActionSpace::default(),
            start_distance_max_m: 0.0,
            goal_distance_max_m: 0.0,
        }
    }
}

impl EpisodeConfig {
    /// Robot and goal may be anywhere in the kitchen.
    fn is_full(&self) -> bool {
        self.start_distance_max_m == 0.0 && self.goal_distance_max_m == 0.0
    }

    /// What a run's evaluation plays by default: what the run has learned, and the fixed episodes where that
    /// is the same task. Training kitchens and scenes (`Split::Train`) have no fixed ones.
    pub fn default_distribution(&self, split: Split) -> Distribution {
        if split == Split::Train || !self.is_full() { Distribution::Run } else { Distribution::Fixed }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;

    #[test]
    fn a_run_is_asked_what_it_has_learned() {
        let episode = |preset: &str| Config::resolve(preset, None).unwrap().episode;
        for (preset, split, expected) in [
            ("paper", Split::Test, Distribution::Fixed),
            ("recipe", Split::Validation, Distribution::Fixed),
            ("paper", Split::Train, Distribution::Run),
            ("demo", Split::Test, Distribution::Run),
            ("demo", Split::Validation, Distribution::Run),
        ] {
            assert_eq!(episode(preset).default_distribution(split), expected, "{preset}, {split:?}");
        }
        let only_goal = EpisodeConfig { goal_distance_max_m: 1.5, ..episode("paper") };
        assert_eq!(only_goal.default_distribution(Split::Test), Distribution::Run);
    }
}
