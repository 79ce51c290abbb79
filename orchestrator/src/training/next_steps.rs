use crate::output::name;
use proto::bounded;
use proto::config::{Config, EnvironmentConfig};
use proto::run_folder::RunFolder;
use proto::shell::quoted;
use proto::task::Restore;
use std::path::Path;

/// This program as a shell finds it: its name where it was found by that, else the path it was called by.
pub fn program() -> String {
    let called = std::env::args().next().filter(|called| called.contains('/'));
    called.map_or_else(|| name::called().to_owned(), quoted)
}

/// The command of the full run that a demonstration stands for, with the file of settings of this one; none where that
/// sets the stages, and so the frames.
pub fn full_run(program: &str, preset: &str, words: impl IntoIterator<Item = String>) -> Option<String> {
    let mut words = words.into_iter().skip_while(|word| word.split('=').next() != Some("--config"));
    let file = words.next().and_then(|word| word.split_once('=').map(|(_, file)| file.to_owned()).or(words.next()));
    let text = file.as_ref().and_then(|file| bounded::read_text(Path::new(file)).ok());
    let settings: Option<toml::Table> = text.and_then(|text| toml::from_str(&text).ok());
    if settings.is_some_and(|settings| settings.contains_key("stages")) {
        return None;
    }
    let file = file.map_or_else(String::new, |file| format!(" --config {}", quoted(file)));
    Some(format!("{program} up --preset {preset}{file}"))
}

/// Whether an environment of one's own may draw pictures: only a program of Python says so.
fn is_drawn(EnvironmentConfig { command, .. }: &EnvironmentConfig) -> bool {
    command.iter().any(|word| word == "stillroom")
}

/// How the episodes of a complete run are looked at.
fn look(program: &str, run: &str, config: &Config) -> Option<String> {
    match &config.environment {
        Some(_) if config.spec().restore == Restore::None => None,
        Some(environment) if !is_drawn(environment) => Some(line("check", &format!("{program} replay {run} --check"))),
        _ => Some(line("look", &format!("{program} replay {run}"))),
    }
}

/// The command that makes films of episodes of environments of one's own, which it names after that; none where they draw
/// no pictures.
pub fn film(program: &str, run: &Path, config: &Config) -> Option<String> {
    let environment = config.environment.as_ref()?;
    let has_films = config.spec().restore != Restore::None && is_drawn(environment);
    has_films.then(|| format!("{program} replay {}", quoted(run)))
}

pub fn resume(program: &str, run: &Path) -> String {
    format!("{program} resume {}", quoted(run))
}

/// A word about a run that begins with stage II and fresh weights, though its preset is one that follows a stage I.
/// `from` is how the stage I is named.
pub fn without_stage_one(config: &Config, from: impl Fn(&str) -> String) -> Option<String> {
    let (experiment, plan) = config.preset.split_once("-stage2-")?;
    let stage_one = format!("{experiment}-stage1-20m");
    config.from.is_none().then(|| {
        format!(
            "{experiment}-stage2-{plan} is stage II alone and begins with fresh weights: give it {}, to begin with those of \
             a stage I",
            from(&stage_one)
        )
    })
}

pub fn go_on(program: &str, run: &Path, hosts: u32) -> String {
    match hosts {
        1 => resume(program, run),
        hosts => format!("the same command again, on each of the {hosts} hosts"),
    }
}

fn line(what: &str, command: &str) -> String {
    format!("{what:<12}{command}")
}

pub fn unfinished(program: &str, folder: &RunFolder, hosts: u32) -> Vec<String> {
    vec![line("go on with", &go_on(program, folder.root(), hosts))]
}

pub fn complete(program: &str, folder: &RunFolder, config: &Config, recorded: bool) -> Vec<String> {
    let run = quoted(folder.root());
    let mut lines = Vec::new();
    if recorded {
        lines.extend(look(program, &run, config));
    }
    lines.push(line("evaluate", &format!("{program} eval {run}")));
    lines.push(line("report", &format!("{program} report {run}")));
    if config.preset == "demo" {
        let full_runs = [("full run", "paper"), ("on a GPU", "recipe")];
        let full = |(what, preset)| Some(line(what, &full_run(program, preset, std::env::args())?));
        lines.extend(full_runs.into_iter().filter_map(full));
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_stage_alone_is_told_of_and_no_other_run() {
        let said = |preset| without_stage_one(&Config::resolve(preset, None).unwrap(), |stage| format!("from {stage}"));
        let alone = said("disturb-stage2-25m").unwrap();
        assert!(alone.starts_with("disturb-stage2-25m is stage II alone and begins with fresh weights"), "{alone}");
        assert!(alone.contains("from disturb-stage1-20m"), "{alone}");
        for other in ["demo", "disturb-two-stage", "disturb-scratch-45m", "disturb-stage1-20m"] {
            assert_eq!(said(other), None);
        }
    }

    #[test]
    fn a_complete_run_is_looked_at_evaluated_and_reported() {
        let folder = RunFolder::new("runs/my run");
        let lines =
            |preset, recorded| complete("./orchestrator", &folder, &Config::resolve(preset, None).unwrap(), recorded);
        let expected = [
            "look        ./orchestrator replay 'runs/my run'",
            "evaluate    ./orchestrator eval 'runs/my run'",
            "report      ./orchestrator report 'runs/my run'",
            "full run    ./orchestrator up --preset paper",
            "on a GPU    ./orchestrator up --preset recipe",
        ];
        assert_eq!(lines("demo", true), expected);
        assert_eq!(lines("paper", false), expected[1..3], "nothing was recorded, and this was the full run");
        let numbers = include_str!("../../../learner/tests/support/numbers.toml");
        let command = |words: &[&str]| {
            let command = words.iter().map(|&word| word.to_owned()).collect();
            let environment = Some(EnvironmentConfig { command, declaration: numbers.to_owned() });
            let task = "numbers".to_owned();
            let config = Config { task, environment, ..Config::resolve("paper", None).unwrap() };
            complete("./orchestrator", &folder, &config, true).remove(0)
        };
        let check = "check       ./orchestrator replay 'runs/my run' --check";
        assert_eq!(command(&["sh", "-c", "./cart_pole"]), check, "a program in C draws no pictures");
        assert_eq!(command(&["python3", "-m", "stillroom", "serve", "gymnasium:CartPole-v1"]), expected[0]);
    }

    #[test]
    fn a_full_run_keeps_the_file_of_settings() {
        let plan = |words: &str| full_run("orchestrator", "paper", words.split(' ').map(str::to_owned));
        let full = |words: &str| plan(words).unwrap();
        assert_eq!(full("up --seed 2 --config mine.toml --view"), "orchestrator up --preset paper --config mine.toml");
        assert_eq!(full("up --config=mine.toml"), "orchestrator up --preset paper --config mine.toml");
        assert_eq!(full("up --preset demo"), "orchestrator up --preset paper");
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("count.toml");
        for (text, is_other) in [("seed = 2\n", true), ("[[stages]]\nname = \"I\"\nframes = 9\n", false)] {
            std::fs::write(&file, text).unwrap();
            assert_eq!(plan(&format!("up --config {}", file.display())).is_some(), is_other, "{text}");
        }
    }

    #[test]
    fn any_other_run_is_gone_on_with() {
        let lines = |hosts| unfinished("orchestrator", &RunFolder::new("runs/a"), hosts);
        assert_eq!(lines(1), ["go on with  orchestrator resume runs/a"]);
        assert_eq!(lines(2), ["go on with  the same command again, on each of the 2 hosts"]);
    }
}
