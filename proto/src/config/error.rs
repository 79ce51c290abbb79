//! Configuration errors with file, line and a suggestion.

use crate::shell::quoted;
use crate::task::SpecError;
use serde::de::DeserializeOwned;
use std::path::PathBuf;

/// What is wrong with a configuration.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    #[error("there is no preset `{name}`{}; `orchestrator presets` lists them", suggestion(.nearest.as_deref()))]
    UnknownPreset {
        /// The unknown name.
        name: String,
        /// The closest existing name.
        nearest: Option<String>,
    },
    #[error("cannot read configuration {path}: {cause}", path = .path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// Why.
        cause: std::io::Error,
    },
    #[error("{cause} (mend it, or: `orchestrator config --of {run} --out {file}`)", run = quoted(.run), file = quoted(.file))]
    OfRun {
        /// What is wrong with it.
        cause: Box<ConfigError>,
        /// The run's folder.
        run: PathBuf,
        /// The file.
        file: PathBuf,
    },
    #[error("{origin}:{line}: unknown key `{key}`{}", suggestion(.nearest.as_deref()))]
    UnknownKey {
        /// File or preset.
        origin: String,
        /// Line, from 1.
        line: usize,
        /// The key.
        key: String,
        /// The closest valid key.
        nearest: Option<String>,
    },
    #[error("{origin}:{line}: {problem}")]
    Invalid {
        /// File or preset.
        origin: String,
        /// Line, from 1.
        line: usize,
        /// The parser's message.
        problem: String,
    },
    #[error("configuration: {key} = {value}: {problem}")]
    OutOfRange {
        /// Dotted key.
        key: &'static str,
        /// Its value.
        value: String,
        /// What it must be.
        problem: &'static str,
    },
    #[error("there is no task `{name}`{}", suggestion(.nearest.as_deref()))]
    UnknownTask {
        name: String,
        /// The closest existing name.
        nearest: Option<String>,
    },
    #[error(
        "{path}: the run's task `{name}` is declared otherwise than in these programs: go on with the version that began \
         it (`run.toml` names it)", path = .path.display()
    )]
    OtherTask { path: PathBuf, name: String },
    #[error("configuration: {key}: {cause}")]
    Task {
        /// Dotted key.
        key: String,
        cause: SpecError,
    },
}

pub(super) fn suggestion(nearest: Option<&str>) -> String {
    nearest.map_or_else(String::new, |nearest| format!(" (did you mean `{nearest}`?)"))
}

/// The candidate closest to `word`, if any is close.
pub fn nearest<'a>(word: &str, candidates: impl Iterator<Item = &'a str>) -> Option<String> {
    candidates
        .map(|candidate| (strsim::jaro_winkler(word, candidate), candidate))
        .filter(|(score, _)| *score > 0.7)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, candidate)| candidate.to_owned())
}

/// Parses TOML; `origin` names the source in errors.
pub fn parse<T: DeserializeOwned>(text: &str, origin: &str) -> Result<T, ConfigError> {
    toml::from_str(text).map_err(|error: toml::de::Error| {
        let line = error.span().map_or(0, |span| text[..span.start].matches('\n').count() + 1);
        let origin = origin.to_owned();
        match unknown_field(error.message()) {
            Some((key, valid)) => {
                let nearest = nearest(&key, valid.iter().map(String::as_str));
                ConfigError::UnknownKey { origin, line, key, nearest }
            }
            None => ConfigError::Invalid { origin, line, problem: in_plain_words(error.message()) },
        }
    })
}

/// A message of serde without the names of Rust's types.
fn in_plain_words(message: &str) -> String {
    let wrong = message.strip_prefix("invalid type: ").or_else(|| message.strip_prefix("invalid value: "));
    let Some((found, expected)) = wrong.and_then(|wrong| wrong.split_once(", expected ")) else {
        return message.replacen("unknown variant ", "unknown value ", 1);
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
