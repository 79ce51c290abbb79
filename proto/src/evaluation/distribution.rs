//! Where an evaluation's episodes come from.

use crate::config::EpisodeConfig;
use crate::kitchen::Split;
use serde::{Deserialize, Serialize};

/// Where an evaluation's episodes come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Distribution {
    /// The fixed episodes of validation and test kitchens, at full distance: the paper's kind.
    #[default]
    Fixed,
    /// Drawn as the run draws its training episodes, within its distances. The same for every policy: an episode
    /// depends on kitchen, number and distances, and on no seed.
    Run,
}

impl Distribution {
    /// What a run's evaluation plays unless told otherwise: what the run has learned, and the fixed ones where that is
    /// the same task. Training kitchens and scenes (`Split::Train`) have no fixed ones.
    pub fn default_of(episode: &EpisodeConfig, split: Split) -> Self {
        if split == Split::Train || !episode.is_full() { Self::Run } else { Self::Fixed }
    }

    /// `fixed` or `run`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Fixed => "fixed",
            Self::Run => "run",
        }
    }
}

/// Which episodes these are, as people read it. Distances are at most, metres; 0 = anywhere.
pub fn describe(distribution: Distribution, start_m: f32, goal_m: f32) -> String {
    let within = |limit_m: f32, of: &str| match limit_m {
        0.0 => "anywhere".to_owned(),
        limit_m => format!("within {limit_m} m of {of}"),
    };
    match distribution {
        Distribution::Fixed => "fixed episodes at full distance".to_owned(),
        Distribution::Run if start_m == 0.0 && goal_m == 0.0 => "drawn episodes at full distance".to_owned(),
        Distribution::Run => format!(
            "drawn episodes near their targets: the robot starts {}, the goal is {}",
            within(start_m, "the target"),
            within(goal_m, "where the target stands")
        ),
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
            ("two-stage", Split::Validation, Distribution::Fixed),
            ("paper", Split::Train, Distribution::Run),
            ("demo", Split::Test, Distribution::Run),
            ("demo", Split::Validation, Distribution::Run),
        ] {
            assert_eq!(Distribution::default_of(&episode(preset), split), expected, "{preset}, {split:?}");
        }
        let only_goal = EpisodeConfig { goal_distance_max_m: 1.5, ..episode("paper") };
        assert_eq!(Distribution::default_of(&only_goal, Split::Test), Distribution::Run);
        let text = describe(Distribution::Run, 0.0, 1.5);
        assert!(text.ends_with("starts anywhere, the goal is within 1.5 m of where the target stands"), "{text}");
    }
}
