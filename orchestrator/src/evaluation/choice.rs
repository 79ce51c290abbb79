//! What `orchestrator eval` and suites are asked, by the same words.

use clap::ValueEnum;
use serde::{Deserialize, Serialize};

/// Kitchens: of training, where episodes are drawn, for none are fixed there; of validation; of test.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum SplitChoice {
    Train,
    Valid,
    Test,
}

/// Targets: not seen in training, seen there, or both.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum ObjectsChoice {
    Novel,
    Seen,
    All,
}

pub fn word(choice: &impl ValueEnum) -> String {
    choice.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
}
