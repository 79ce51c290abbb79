//! State of a suite: `suite.json`, for people, scripts and the next call. Progress is read from the run folders; this
//! file adds what they do not contain: the number of tries and the reason of a failure.

use crate::run::damaged;
use anyhow::{Context, Result};
use proto::SCHEMA_VERSION;
use proto::bounded;
use proto::run_folder::write_atomically;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(tag = "status", rename_all = "snake_case")]
pub enum Status {
    #[default]
    Waiting,
    Training,
    Evaluating {
        evaluation: String,
    },
    /// Somebody else stopped it; the next call goes on with it.
    Stopped,
    Done,
    Failed {
        reason: String,
    },
}

impl Status {
    pub fn word(&self) -> &'static str {
        match self {
            Self::Waiting => "waiting",
            Self::Training => "training",
            Self::Evaluating { .. } => "evaluating",
            Self::Stopped => "stopped",
            Self::Done => "complete",
            Self::Failed { .. } => "failed",
        }
    }

    /// Of a failure.
    pub fn reason(&self) -> Option<&str> {
        if let Self::Failed { reason } = self { Some(reason) } else { None }
    }

    pub fn text(&self) -> String {
        match self {
            Self::Evaluating { evaluation } => format!("evaluating ({evaluation})"),
            Self::Failed { reason } => format!("failed: {reason}"),
            other => other.word().into(),
        }
    }
}

#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct RunStatus {
    #[serde(flatten)]
    pub status: Status,
    pub tries: u32,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct State {
    pub schema_version: u32,
    pub runs: BTreeMap<String, RunStatus>,
}

impl State {
    /// The file's entries for these runs; runs without an entry wait. Without a file all wait.
    pub fn read<'a>(path: &Path, names: impl Iterator<Item = &'a str>) -> Result<Self> {
        let mut known: BTreeMap<String, RunStatus> = match bounded::read_text(path) {
            Ok(text) => {
                let state: Self = serde_json::from_str(&text)
                    .with_context(|| damaged(path, "delete it: what is trained and evaluated stands in other files"))?;
                state.runs
            }
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => BTreeMap::new(),
            Err(error) => return Err(error).with_context(|| path.display().to_string()),
        };
        let runs = names.map(|name| {
            let mut standing = known.remove(name).unwrap_or_default();
            // Whoever worked on it is gone.
            standing.status = Status::Waiting;
            (name.to_owned(), standing)
        });
        Ok(Self { schema_version: SCHEMA_VERSION, runs: runs.collect() })
    }

    pub fn write(&self, path: &Path) -> Result<()> {
        let mut text = serde_json::to_string_pretty(self).context("suite.json")?;
        text.push('\n');
        write_atomically(path, text.as_bytes()).with_context(|| format!("cannot write {}", path.display()))
    }

    pub fn of(&mut self, name: &str) -> &mut RunStatus {
        self.runs.entry(name.to_owned()).or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tries_are_remembered_and_nobody_works_on_what_a_dead_suite_worked_on() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("suite.json");
        let mut state = State::read(&path, ["a", "b"].into_iter()).unwrap();
        assert_eq!(*state.of("a"), RunStatus::default());
        *state.of("a") = RunStatus { status: Status::Training, tries: 2 };
        *state.of("b") = RunStatus { status: Status::Failed { reason: "no space".into() }, tries: 1 };
        state.write(&path).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.contains("\"status\": \"failed\"") && text.contains("no space"), "{text}");
        let mut again = State::read(&path, ["b", "a", "c"].into_iter()).unwrap();
        assert_eq!(again.of("a").clone(), RunStatus { status: Status::Waiting, tries: 2 });
        assert_eq!(again.of("b").tries, 1);
        assert_eq!(again.runs.len(), 3);
    }
}
