use super::distribution::Distribution;
use crate::kitchen::{KitchenId, KitchenRange, Kitchens, Split, TargetCategory};
use serde::{Deserialize, Serialize};

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ObjectSet {
    /// The six categories that are targets in evaluation only.
    Novel,
    /// The six categories that are targets in training.
    Seen,
    /// All twelve.
    All,
    /// The task declares no targets.
    NoTargets,
}

impl ObjectSet {
    /// Whether targets of this category belong to the set.
    pub fn contains(self, category: TargetCategory) -> bool {
        match self {
            Self::Novel => TargetCategory::NOVEL.contains(&category),
            Self::Seen => TargetCategory::SEEN.contains(&category),
            Self::All | Self::NoTargets => true,
        }
    }

    /// `novel`, `seen`, `all` or `no`: the targets.
    pub fn name(self) -> &'static str {
        match self {
            Self::Novel => "novel",
            Self::Seen => "seen",
            Self::All => "all",
            Self::NoTargets => "no",
        }
    }
}

/// Episodes of an evaluation of environments that are not built in, unless it is asked for another number.
pub const SEEDED_EPISODES: u32 = 100;
pub const SEEDED_EPISODES_MOST: u32 = 100_000;

/// Request of an evaluation: a table of the configuration that `orchestrator eval` writes for its processes. A run has
/// none.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EvaluationConfig {
    /// Kitchens; train where they are the run's scenes, or procedural ones.
    pub split: Split,
    /// Procedural kitchens instead of a split's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub procedural: Option<KitchenRange>,
    /// A single kitchen of the split instead of all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kitchen: Option<KitchenId>,
    pub objects: ObjectSet,
    /// The first this many episodes of each kitchen and of each of the sets novel and seen; 0 = all. Of environments that
    /// are not built in: this many, 0 = 100.
    pub episodes: u32,
    #[serde(default)]
    pub distribution: Distribution,
    /// Targets that each scene of the configuration has; empty where kitchens are built in, which have all.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub scene_targets: Vec<Vec<TargetCategory>>,
    /// The most probable action instead of a sampled one.
    pub deterministic: bool,
    /// State hashes have an episode's number in its kitchen. In older evaluations they have the environment's own count
    /// of episodes, which depends on how many environments there are.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub hashes_by_kitchen: bool,
    /// Steps a second at most, for somebody who watches.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub steps_per_s: Option<u32>,
    /// Manifest of the checkpoint, or a policy file; none = weights as a fresh run with this configuration's seed begins
    /// with.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub checkpoint: Option<String>,
}

impl EvaluationConfig {
    /// The first `episodes` fixed episodes of each kitchen of a split (0 = all), with sampled actions and the weights
    /// that a fresh run begins with.
    pub fn fixed(split: Split, objects: ObjectSet, episodes: u32) -> Self {
        Self {
            split,
            procedural: None,
            kitchen: None,
            objects,
            episodes,
            distribution: Distribution::Fixed,
            scene_targets: Vec::new(),
            deterministic: false,
            hashes_by_kitchen: true,
            steps_per_s: None,
            checkpoint: None,
        }
    }

    pub fn kitchens(&self) -> Kitchens {
        match (self.procedural, self.kitchen, self.scene_targets.len()) {
            _ if self.distribution == Distribution::Seeds => Kitchens::Elsewhere,
            (Some(range), ..) => Kitchens::Procedural(range),
            (None, Some(kitchen), _) => Kitchens::One(kitchen),
            (None, None, 0) => Kitchens::Split(self.split),
            (None, None, scenes) => Kitchens::Scenes(scenes),
        }
    }
}
