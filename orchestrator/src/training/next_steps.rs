use proto::config::Config;
use proto::run_folder::RunFolder;
use proto::shell::quoted;
use std::path::Path;

/// This program as a shell finds it: `orchestrator` where it was found by its name, else the path it was called by.
pub fn program() -> String {
    let called = std::env::args().next().filter(|called| called.contains('/'));
    called.map_or_else(|| "orchestrator".to_owned(), quoted)
}

/// The command of the full run that a demonstration stands for, with the file of settings of this one.
pub fn full_run(program: &str, preset: &str, words: impl IntoIterator<Item = String>) -> String {
    let mut words = words.into_iter().skip_while(|word| word.split('=').next() != Some("--config"));
    let file = words.next().and_then(|word| word.split_once('=').map(|(_, file)| file.to_owned()).or(words.next()));
    let file = file.map_or_else(String::new, |file| format!(" --config {}", quoted(file)));
    format!("{program} up --preset {preset}{file}")
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

pub fn complete(program: &str, folder: &RunFolder, preset: &str, recorded: bool) -> Vec<String> {
    let run = quoted(folder.root());
    let mut lines = Vec::new();
    if recorded {
        lines.push(line("look", &format!("{program} replay {run}")));
    }
    lines.push(line("evaluate", &format!("{program} eval {run}")));
    lines.push(line("report", &format!("{program} report {run}")));
    if preset == "demo" {
        lines.push(line("full run", &full_run(program, "paper", std::env::args())));
        lines.push(line("on a GPU", &full_run(program, "recipe", std::env::args())));
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
        let lines = |preset, recorded| complete("./orchestrator", &folder, preset, recorded);
        let expected = [
            "look        ./orchestrator replay 'runs/my run'",
            "evaluate    ./orchestrator eval 'runs/my run'",
            "report      ./orchestrator report 'runs/my run'",
            "full run    ./orchestrator up --preset paper",
            "on a GPU    ./orchestrator up --preset recipe",
        ];
        assert_eq!(lines("demo", true), expected);
        assert_eq!(lines("paper", false), expected[1..3], "nothing was recorded, and this was the full run");
    }

    #[test]
    fn a_full_run_keeps_the_file_of_settings() {
        let full = |words: &str| full_run("orchestrator", "paper", words.split(' ').map(str::to_owned));
        assert_eq!(full("up --seed 2 --config mine.toml --view"), "orchestrator up --preset paper --config mine.toml");
        assert_eq!(full("up --config=mine.toml"), "orchestrator up --preset paper --config mine.toml");
        assert_eq!(full("up --preset demo"), "orchestrator up --preset paper");
    }

    #[test]
    fn any_other_run_is_gone_on_with() {
        let lines = |hosts| unfinished("orchestrator", &RunFolder::new("runs/a"), hosts);
        assert_eq!(lines(1), ["go on with  orchestrator resume runs/a"]);
        assert_eq!(lines(2), ["go on with  the same command again, on each of the 2 hosts"]);
    }
}
