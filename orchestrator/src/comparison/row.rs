//! A line of a comparison.

use serde::Serialize;
use serde_json::Value;

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    pub name: String,
    /// Of each run; null of those that have no such thing.
    pub values: Vec<Value>,
    /// The same as people read it.
    #[serde(skip)]
    pub shown: Vec<String>,
}
