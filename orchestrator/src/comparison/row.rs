//! A row of a comparison: a figure or a setting of each run.

use crate::output::format::{self, shown};
use proto::task::Described;
use serde::Serialize;
use std::time::Duration;

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    pub name: String,
    /// Of each run; null of those that have no such thing.
    pub values: Vec<serde_json::Value>,
    #[serde(skip)]
    pub shown: Vec<String>,
    #[serde(skip)]
    pub format: Format,
}

/// How a number is shown.
#[derive(Debug, Clone, PartialEq)]
pub enum Format {
    /// It is none, or a mean of it says nothing.
    Text,
    Count,
    Decimals(usize),
    Rate,
    Seconds,
    Metric(Described),
}

impl Format {
    pub fn shown(&self, value: f64) -> String {
        match self {
            Self::Text => String::new(),
            Self::Count => format::count(value.round() as u64),
            Self::Decimals(decimals) => format::number(Some(value), *decimals),
            Self::Rate => format::rate(value),
            Self::Seconds => format::duration(Duration::try_from_secs_f64(value).unwrap_or_default()),
            Self::Metric(one) => shown(one, Some(value)),
        }
    }
}
