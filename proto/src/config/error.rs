//! Configuration errors with file, line and a suggestion.

use crate::likeness::{nearest, suggestion};
use crate::task::SpecError;
use serde::de::DeserializeOwned;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    #[error("there is no preset `{name}`{}", unknown(.name, .nearest.as_deref()))]
    UnknownPreset { name: String, nearest: Option<String> },
    #[error("cannot read configuration {path}: {}", unread(.cause), path = .path.display())]
    Unreadable { path: PathBuf, cause: std::io::Error },
    #[error("{cause} (mend it, or{remedy})")]
    OfRun { cause: Box<ConfigError>, remedy: String },
    #[error("{origin}:{line}: unknown key `{key}`{}", suggestion(.nearest.as_deref()))]
    UnknownKey {
        /// File or preset.
        origin: String,
        /// Line, from 1.
        line: usize,
        key: String,
        nearest: Option<String>,
    },
    #[error("{origin}:{line}: {problem}")]
    Invalid { origin: String, line: usize, problem: String },
    #[error("{place}: {key} = {value}: {problem}")]
    OutOfRange {
        /// `configuration`, or the file that sets it and the line in it.
        place: String,
        /// Dotted key.
        key: &'static str,
        value: String,
        problem: &'static str,
    },
    #[error("there is no task `{name}`{known}")]
    UnknownTask { name: String, known: String },
    #[error(
        "{path}: the run's task `{name}` is declared otherwise than in these programs: go on with the version that began \
         it (`run.toml` names it)", path = .path.display()
    )]
    OtherTask { path: PathBuf, name: String },
    #[error("configuration: {key}: {cause}")]
    Task { key: String, cause: SpecError },
}

/// The end of a message about a name that no preset has.
fn unknown(name: &str, nearest: Option<&str>) -> String {
    if Path::new(name).extension().is_some_and(|extension| extension == "toml") {
        format!(": a file is given as `--config {name}`")
    } else {
        format!("{}; `orchestrator presets` lists them", suggestion(nearest))
    }
}

/// Why a file cannot be read.
fn unread(cause: &std::io::Error) -> String {
    if cause.kind() == ErrorKind::NotFound { "there is no such file".to_owned() } else { cause.to_string() }
}

/// Parses TOML; `origin` names the source in errors.
pub fn parse<T: DeserializeOwned>(text: &str, origin: &str) -> Result<T, ConfigError> {
    toml::from_str(text).map_err(|error: toml::de::Error| {
        let line = error.span().map_or(0, |span| text[..span.start].matches('\n').count() + 1);
        let shown = text.lines().nth(line.saturating_sub(1)).unwrap_or_default();
        let origin = origin.to_owned();
        if let Some((key, valid)) = unknown_field(error.message()) {
            let nearest = nearest(&key, valid.iter().map(String::as_str));
            return ConfigError::UnknownKey { origin, line, key, nearest };
        }
        let is_other = Path::new(&origin).extension().is_some_and(|ending| ending != "toml");
        let remark = if is_other { ": it must be TOML" } else { "" };
        ConfigError::Invalid { origin, line, problem: problem_of(shown, error.message()) + remark }
    })
}

/// What is wrong with a line of TOML.
pub fn problem_of(line: &str, message: &str) -> String {
    let value = line.split_once('=').map(|(_, value)| value.split('#').next().unwrap_or_default().trim());
    if value == Some("") && message.starts_with("string values must be quoted") {
        return "the value after `=` is missing".to_owned();
    }
    in_plain_words(message)
}

/// A message of serde without the names of Rust's types.
pub(super) fn in_plain_words(message: &str) -> String {
    let wrong = message.strip_prefix("invalid type: ").or_else(|| message.strip_prefix("invalid value: "));
    let Some((found, expected)) = wrong.and_then(|wrong| wrong.split_once(", expected ")) else {
        if let Some(rest) = message.strip_prefix("unknown variant `") {
            let mut names = rest.split('`').step_by(2);
            let (word, mut known) = (names.next().unwrap_or_default(), names.clone());
            // By its letters it is nearer to `cpu`.
            let is_gpu = word.to_lowercase().starts_with("gpu") && known.any(|name| name == "cuda");
            let meant = if is_gpu { Some("cuda".to_owned()) } else { nearest(word, names) };
            return format!("unknown value `{rest}{}", suggestion(meant.as_deref()));
        }
        return message.replacen("missing field ", "missing key ", 1);
    };
    let expected = match expected {
        "f32" | "f64" => "a number",
        "u32" => "a whole number from 0 to 4294967295",
        "u8" => "a whole number from 0 to 255",
        "u64" | "usize" => "a whole number, 0 or greater",
        "a boolean" => "true or false",
        "a sequence" => "a list",
        other if other.starts_with("struct ") => "a table",
        other => other,
    };
    let found = match found {
        "sequence" => "a list",
        "map" => "a table",
        other => ["string ", "integer ", "floating point ", "boolean "]
            .iter()
            .find_map(|kind| other.strip_prefix(kind))
            .unwrap_or(other),
    };
    format!("expected {expected}, found {found}")
}

/// Takes serde's "unknown field `a`, expected one of `b`, `c`" apart.
fn unknown_field(message: &str) -> Option<(String, Vec<String>)> {
    let rest = message.strip_prefix("unknown field `")?;
    let mut words = rest.split('`');
    let key = words.next()?.to_owned();
    Some((key, words.skip(1).step_by(2).map(str::to_owned).collect()))
}
