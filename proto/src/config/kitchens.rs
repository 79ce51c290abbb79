use crate::kitchen::KitchenRange;
use serde::{Deserialize, Serialize};

/// Where training kitchens come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum KitchenSource {
    /// The 19 training kitchens, one an actor; with `scenes` those.
    BuiltIn,
    /// Kitchens drawn from a number and a seed. Every environment has one of its own and goes on to others.
    Procedural,
}

/// Procedural kitchens. Only `source` matters where that is `built_in`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct KitchensConfig {
    /// Which kind.
    pub source: KitchenSource,
    /// How many procedural kitchens there are: numbers 1000, 1001, ... Each visit of an environment draws one of them
    /// from (seed, environment, episode), all with equal probability.
    pub count: u32,
    /// Episodes that an environment plays in a kitchen before it goes on to another.
    pub episodes_each: u32,
    /// Seed of the procedural kitchens: another one gives others under the same numbers.
    pub seed: u64,
}

impl Default for KitchensConfig {
    fn default() -> Self {
        Self { source: KitchenSource::BuiltIn, count: 1000, episodes_each: 20, seed: 0 }
    }
}

impl KitchensConfig {
    /// The procedural kitchens; none if the source is another, or there are not so many.
    pub fn range(&self) -> Option<KitchenRange> {
        match self.source {
            KitchenSource::BuiltIn => None,
            KitchenSource::Procedural => KitchenRange::first(self.count),
        }
    }
}
