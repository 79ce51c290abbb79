//! What to write in place of a value that a key cannot have.

use super::error::in_plain_words;
use super::{Config, overlay};
use crate::shell::quoted;
use toml::{Table, Value};

const STAGE: &str = "'stages=[{ name = \"I\", reward = \"r\", frames = 1000000 }]'";

/// A key's ending, the unit that it means, and other units in it.
type Unit = (&'static str, &'static str, &'static [(&'static str, f64)]);

const UNITS: [Unit; 3] = [
    ("_s", "seconds", &[("s", 1.0), ("sec", 1.0), ("m", 60.0), ("min", 60.0), ("h", 3600.0)]),
    ("_m", "metres", &[("m", 1.0), ("km", 1e3)]),
    (
        "_bytes",
        "bytes",
        &[
            ("B", 1.0),
            ("kB", 1e3),
            ("KB", 1e3),
            ("MB", 1e6),
            ("GB", 1e9),
            ("KiB", 1024.0),
            ("MiB", 1048576.0),
            ("GiB", 1073741824.0),
            ("K", 1024.0),
            ("M", 1048576.0),
            ("G", 1073741824.0),
        ],
    ),
];

/// The unit of a key's numbers, as a message has it behind `a number`.
pub(super) fn unit_of(key: &str) -> Option<&'static str> {
    UNITS.iter().find(|(ending, ..)| key.ends_with(ending)).map(|(_, unit, _)| *unit)
}

/// A problem with a key's value, `text` as it was written, and what to write instead, if that can be said. Without a
/// problem only the latter.
pub(super) fn explained(key: &str, text: &str, problem: String) -> String {
    let bare = text.trim_matches(['"', '\'']);
    if problem == "wanted string or table" {
        // The name of a choice: another try says which there are.
        return with_value(key, bare.into()).map_or_else(|error| in_plain_words(error.message()), |_| problem);
    }
    if problem.starts_with("unknown value") {
        return problem;
    }
    let (first, is_of_list) = (key.split('.').next().unwrap_or_default(), problem.starts_with("expected a list"));
    if problem.starts_with("expected a table") || (first == "rewards" && is_of_list) {
        return if first.starts_with("reward") && !key.contains('.') {
            format!("a stage names its reward, as in {STAGE}")
        } else {
            keys_of(key, text).unwrap_or(problem)
        };
    }
    let without_found = problem.split(", found").next().unwrap_or_default();
    let colon = if problem.is_empty() { "" } else { ": " };
    let fits = |value: &str| with_value(key, value_of(value)).is_ok();
    if let Some(value) = meant(key, bare).into_iter().find(|value| fits(value)) {
        return format!("{without_found}{colon}write {}", quoted(format!("{key}={value}")));
    }
    let parts = parts_of(bare);
    if parts.len() > 1 && !bare.starts_with('[') && parts.iter().all(|part| fits(part)) {
        return "one value goes here, not several: `orchestrator suite` trains with each (docs/report.md)".to_owned();
    }
    if first == "stages" && (is_of_list || problem.starts_with("missing key")) {
        return format!(
            "{without_found}: a stage has name, reward and frames, as in {STAGE}; `--frames` scales all stages"
        );
    }
    if problem == "expected a list, found a table" {
        return format!("{problem}: a list is set whole, as in '{first}=[...]'");
    }
    problem
}

/// The default configuration with another value of a key.
pub(super) fn with_value(key: &str, value: Value) -> Result<Config, toml::de::Error> {
    let nested = |inner, name: &str| Table::from_iter([(name.to_owned(), inner)]).into();
    let mut table = Config::default().to_table();
    if let Value::Table(set) = key.rsplit('.').fold(value, nested) {
        overlay(&mut table, set);
    }
    table.try_into()
}

/// A value as TOML, or a word.
fn value_of(text: &str) -> Value {
    let read = toml::from_str::<Table>(&format!("value = {text}")).ok().and_then(|mut table| table.remove("value"));
    read.unwrap_or_else(|| text.into())
}

fn parts_of(text: &str) -> Vec<&str> {
    let inner = text.trim_matches(['[', ']', '(', ')']);
    inner.split([',', ' ']).map(str::trim).filter(|part| !part.is_empty()).collect()
}

/// What a text was perhaps meant to be, as TOML.
fn meant(key: &str, text: &str) -> Vec<String> {
    let parts = parts_of(text);
    let is_closed = text.starts_with('[') == text.ends_with(']');
    let switch = match text.to_lowercase().as_str() {
        "true" | "on" | "yes" | "1" => Some("true".to_owned()),
        "false" | "off" | "no" | "0" => Some("false".to_owned()),
        _ => None,
    };
    let lists = [parts.join(", "), parts.iter().map(|part| format!("\"{part}\"")).collect::<Vec<_>>().join(", ")];
    let lists = lists.into_iter().filter(|_| is_closed && !parts.is_empty()).map(|inner| format!("[{inner}]"));
    number(key, text).into_iter().chain(switch).chain(lists).collect()
}

/// A number that was written with a comma, in percent, as a fraction or with a unit.
fn number(key: &str, text: &str) -> Option<String> {
    if let Some((whole, decimals)) = text.split_once(',') {
        let is_thousands = decimals.split(',').all(|group| group.len() == 3) && whole != "0";
        return Some(if is_thousands { text.replace(',', "_") } else { format!("{whole}.{decimals}") });
    }
    let parsed = |text: &str| text.trim().parse::<f64>().ok().filter(|number| number.is_finite());
    if let Some(percents) = text.strip_suffix('%') {
        return Some((parsed(percents)? / 100.0).to_string());
    }
    if let Some((above, below)) = text.split_once('/') {
        return Some((parsed(above)? / parsed(below)?).to_string());
    }
    if let Some(plain) = parsed(text) {
        return Some(plain.to_string());
    }
    let (_, _, units) = UNITS.iter().find(|(ending, ..)| key.ends_with(ending))?;
    let at = text.find(|letter: char| letter.is_ascii_alphabetic())?;
    let (amount, unit) = (parsed(&text[..at])?, &text[at..]);
    // Divided: 70 times 0.01 is not 0.7.
    let small = [("_s", "ms", 1000.0), ("_m", "mm", 1000.0), ("_m", "cm", 100.0)];
    if let Some((.., parts)) = small.iter().find(|(ending, name, _)| key.ends_with(ending) && *name == unit) {
        return Some((amount / parts).to_string());
    }
    let (_, factor) = units.iter().find(|(name, _)| *name == unit)?;
    Some((amount * factor).to_string())
}

/// The keys of a table that was set as if it were one key, which can have this value.
fn keys_of(table: &str, value: &str) -> Option<String> {
    let all = Config::default().to_table();
    let keys: Vec<&String> = all.get(table)?.as_table()?.keys().collect();
    let takes = |key: &&&String| {
        with_value(&format!("{table}.{key}"), value_of(value)).is_ok_and(|config| config.validate().is_ok())
    };
    let mut taking: Vec<&str> = keys.iter().filter(takes).map(|key| key.as_str()).collect();
    if let Some(main) = ["enabled", "count"].into_iter().find(|main| taking.contains(main)) {
        taking = vec![main];
    }
    let said = if taking.is_empty() {
        keys.iter().map(|key| key.as_str()).collect::<Vec<_>>().join(", ")
    } else {
        let set = |key: &&str| quoted(format!("{table}.{key}={value}"));
        format!("write {}", taking.iter().map(set).collect::<Vec<_>>().join(" or "))
    };
    Some(format!("`{table}` has keys of its own: {said}"))
}
