//! What is wrong with the file of a suite, and what to write instead.

use proto::config::{Config, frames_in, problem_of};
use proto::likeness::{nearest, suggestion};

/// What is wrong with a line of the file, which is shown, and for an unknown key the one that was probably meant.
pub fn in_words(text: &str, error: &toml::de::Error) -> anyhow::Error {
    let meant = error.message().strip_prefix("unknown field ").and_then(|names| {
        let mut names = names.split('`').skip(1).step_by(2);
        nearest(names.next()?, names)
    });
    let number = error.span().map_or(0, |span| text[..span.start].matches('\n').count());
    let line = text.lines().nth(number).unwrap_or_default().trim();
    let problem = problem_of(line, error.message()).replacen("unknown field", "unknown key", 1);
    let problem =
        if line.starts_with("frames") { problem.replacen("0 or greater", "1 or greater", 1) } else { problem };
    let place = if line.is_empty() { String::new() } else { format!("line {}, `{line}`: ", number + 1) };
    let remedy = if meant.is_some() { suggestion(meant.as_deref()) } else { remedy(line, &problem) };
    anyhow::anyhow!("{place}{problem}{remedy}")
}

/// What to write in place of a line.
fn remedy(line: &str, problem: &str) -> String {
    let (key, value) = line.split_once('=').unwrap_or((line, ""));
    let (key, value) = (key.trim().trim_matches(['[', ']']), value.trim().trim_matches('"'));
    let is_shape =
        ["expected a table", "expected a list", "missing key"].iter().any(|start| problem.starts_with(start));
    let key = if problem == "missing key `runs`" { "runs" } else { key };
    match key {
        "runs" if is_shape => ": each run begins with a line [[runs]], and below it preset = \"demo\"".to_owned(),
        "evaluations" if is_shape => {
            ": each evaluation begins with a line [[evaluations]], and below it split = \"test\"".to_owned()
        }
        "seeds" => ": a list of whole numbers, as in seeds = [1, 2]".to_owned(),
        "frames" => frames_in(value).map_or_else(String::new, |frames| format!(": write frames = {frames}")),
        _ if !problem.starts_with("unknown key") || !is_setting(key) => String::new(),
        _ if line.starts_with('[') => "; `orchestrator up --config FILE` takes a configuration".to_owned(),
        _ => format!("; a setting is written config.{line}"),
    }
}

fn is_setting(key: &str) -> bool {
    let table = key.split('.').next().unwrap_or_default();
    Config::default().to_table().contains_key(table)
}

/// The first of many, and how many more there are.
pub fn some_of(mut many: Vec<String>) -> String {
    const NAMED: usize = 3;
    let more = many.len().saturating_sub(NAMED);
    many.truncate(NAMED);
    let rest = if more > 0 { format!(" and {more} more") } else { String::new() };
    many.join(", ") + &rest
}
