use super::column_map::ColumnMap;
use super::noise::Noise;
use proto::config::Config;
use proto::task::{Composition, Condition, Spec};

#[derive(Debug, Clone, Copy)]
pub struct Settings {
    pub column_map: ColumnMap,
    pub task: &'static Spec,
    pub seed: u64,
    pub noise: Noise,
    pub max_episode_steps: u32,
    /// Discount a step, of returns and of the cost that PPO-Lagrangian constrains.
    pub gamma: f64,
    /// Label and cost.
    pub signals: Signals,
    pub learner_incarnation: u32,
    pub recorded: bool,
}

/// The reward in force.
#[derive(Debug, Clone, PartialEq)]
pub struct Reward {
    pub composition: Composition,
    /// PPO-Lagrangian's, if the reward has it.
    pub multiplier: f32,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Signals {
    /// What the auxiliary task predicts.
    pub label: Option<Condition>,
    /// What PPO-Lagrangian constrains: index of the part among the channels, and its weight.
    pub cost: Option<(usize, f32)>,
}

impl Signals {
    pub fn of(config: &Config) -> Self {
        Self { label: config.label(), cost: config.spec().cost() }
    }

    /// Whether the label holds of a step. `part`: a part's number by the index of its channel.
    pub(crate) fn labels(&self, part: impl Fn(usize) -> f32) -> bool {
        self.label.is_some_and(|label| label.holds(part))
    }
}
