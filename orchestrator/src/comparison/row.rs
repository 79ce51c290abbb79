use serde::Serialize;
use serde_json::Value;

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    pub name: String,
    /// Of each run; null of those that have no such thing.
    pub values: Vec<Value>,
    #[serde(skip)]
    pub shown: Vec<String>,
}
