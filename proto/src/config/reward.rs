use serde::de::{Deserializer, MapAccess, Visitor};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;

/// Weights inside rewards.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct RewardConfig {
    /// Weights that the task's rewards name, e.g. `lambda_disturb` in r′.
    #[serde(flatten)]
    pub weights: BTreeMap<String, f32>,
    /// The multiplier of rewards that have PPO-Lagrangian's.
    pub lagrangian: LagrangianConfig,
}

/// PPO-Lagrangian's multiplier: a stage begins with `initial`, and every update adds `learning_rate` times the mean
/// discounted cost of the episodes that ended.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LagrangianConfig {
    /// `λ_0`.
    pub initial: f64,
    /// `η_λ`, per unit of the cost and update. The paper does not give its value.
    pub learning_rate: f64,
}

impl Default for LagrangianConfig {
    fn default() -> Self {
        Self { initial: 1.0, learning_rate: 0.01 }
    }
}

/// Written by hand, because serde's `flatten` forgets the lines of mistakes.
impl<'de> Deserialize<'de> for RewardConfig {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Keys;
        impl<'de> Visitor<'de> for Keys {
            type Value = RewardConfig;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("struct RewardConfig")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<RewardConfig, A::Error> {
                let mut config = RewardConfig::default();
                while let Some(key) = map.next_key::<String>()? {
                    if key == "lagrangian" {
                        config.lagrangian = map.next_value()?;
                    } else {
                        config.weights.insert(key, map.next_value()?);
                    }
                }
                Ok(config)
            }
        }
        deserializer.deserialize_map(Keys)
    }
}
