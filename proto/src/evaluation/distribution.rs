use crate::kitchen::Split;
use serde::{Deserialize, Serialize};

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Distribution {
    /// The fixed episodes of validation and test kitchens, at full distance: the paper's kind.
    #[default]
    Fixed,
    /// Drawn as the run draws its training episodes, within its distances. The same for every policy: an episode
    /// depends on kitchen, number and distances, and on no seed.
    Run,
    /// Of environments that are not built in: each begins with `reset(seed=...)` under a fixed seed, the same for every
    /// policy.
    Seeds,
}

/// The seed of an evaluation's episode in environments that are not built in. Validation, which chooses a checkpoint, and
/// the test have no episode in common.
pub fn seed_of(split: Split, episode: u32) -> u32 {
    const FIRST_OF_VALIDATION: u32 = 1_000_000;
    match split {
        Split::Validation => FIRST_OF_VALIDATION + episode,
        Split::Train | Split::Test => episode,
    }
}

impl Distribution {
    /// `fixed`, `run` or `seeds`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Fixed => "fixed",
            Self::Run => "run",
            Self::Seeds => "seeds",
        }
    }
}

/// Which episodes these are, as people read it. Distances are at most, metres; 0 = anywhere.
pub fn describe(distribution: Distribution, start_m: f32, goal_m: f32) -> String {
    match distribution {
        Distribution::Fixed => "fixed episodes at full distance".to_owned(),
        Distribution::Seeds => "episodes of fixed seeds".to_owned(),
        Distribution::Run if start_m == 0.0 && goal_m == 0.0 => "drawn episodes at full distance".to_owned(),
        Distribution::Run => {
            let limited = [("the robot starts", start_m), ("the goal is", goal_m)]
                .into_iter()
                .filter(|(_, limit_m)| *limit_m != 0.0);
            let limits: Vec<String> = limited.map(|(what, limit_m)| format!("{what} within {limit_m} m")).collect();
            format!("drawn episodes at short distances: {}", limits.join(", "))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_are_told() {
        let text = |start_m, goal_m| describe(Distribution::Run, start_m, goal_m);
        assert_eq!(text(0.0, 1.5), "drawn episodes at short distances: the goal is within 1.5 m");
        assert!(text(0.7, 1.5).ends_with("distances: the robot starts within 0.7 m, the goal is within 1.5 m"));
    }
}
