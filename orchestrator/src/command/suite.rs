use super::list::RUNS;
use super::status::of_suite;
use super::up::needs_environment;
use crate::output::format::{bytes, count, counted, duration};
use crate::output::table::aligned;
use crate::output::terminal;
use crate::preflight::disk::need;
use crate::preflight::{device, libtorch, programs};
use crate::report_builder::files;
use crate::report_builder::gather::gather;
use crate::run::scenes;
use crate::suite::{Asked, BUILT_IN, Suite, SuiteEntry, SuiteFolder, SuiteOutcome, begun, run as work, standings};
use crate::supervisor::session::EXIT_INTERRUPTED;
use crate::training::next_steps::program;
use crate::viewer::RunReaders;
use crate::wrong::judged;
use anyhow::{Context, Result, ensure};
use proto::device::VISIBLE_DEVICES;
use proto::shell::quoted;
use proto::stage::total_frames;
use report::Options;
use serde_json::json;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;
use view::data::{Card, Runs};

const EXAMPLE: &str = r#"# of runs that name none
seeds = [1, 2, 3]
# optional: all stages of every run scaled to this sum
frames = 1_000_000
# optional: keys laid over every preset
config.learner.threads = 2

# of every trained run, as `orchestrator eval` takes it
[[evaluations]]
# or "validation", "train"
split = "test"
# or "seen", "all"
objects = "novel"
# optional; also deterministic = true
episodes = 60
# optional: the best by its own validation; else "newest"
checkpoint = "best"

[[runs]]
preset = "disturb-stage1-20m"

[[runs]]
preset = "none-two-stage"
# optional: what its folders are called
name = "small-steps"
# optional; also frames
seeds = [1]
# optional: keys laid over preset and suite
config.ppo.learning_rate = 1e-4

[[runs]]
preset = "disturb-stage2-25m"
# optional: begin with the weights of a run above
from = "disturb-stage1-20m"

[[runs]]
preset = "lambda-15"
name = "rates"
# optional: every combination is a run: rates-clip=0.1-learning_rate=0.001-1
grid = { "ppo.clip" = [0.1, 0.2], "ppo.learning_rate" = [3e-4, 1e-3] }
seeds = [1]
"#;

fn after_help() -> String {
    let example = EXAMPLE.lines().map(|line| if line.is_empty() { String::new() } else { format!("  {line}") });
    format!(
        "The file, TOML:\n{}\n
Examples:
  # built in: {}
  orchestrator suite two-seeds
  # into runs/table-1
  orchestrator suite table-1.toml
  orchestrator suite table-1.toml --gpus 0,1,2,3
  # with other seeds than those in the file
  orchestrator suite table-1.toml --seed 4,5,6
  # the runs that the paper's table still lacks
  orchestrator suite paper --table docs/results/paper.json
  # says what it would do
  orchestrator suite table-1.toml --check",
        example.collect::<Vec<_>>().join("\n"),
        BUILT_IN.map(|(name, _)| name).join(", ")
    )
}

/// Train and evaluate a list of presets with several seeds each, and report on them
///
/// Runs go one after another, or one on each of the GPUs given. The suite can be stopped and killed at any time: the
/// same command goes on where it was. A run that fails does not keep the others from going on, and is tried again by
/// the next call. Exit status 0 when every run is trained and evaluated, and after an orderly stop; 130 after a second
/// Ctrl-C, which ends all processes at once.
#[derive(Debug, clap::Args)]
#[command(after_help = after_help())]
pub struct SuiteArgs {
    /// What to run: a file, or the name of a built-in suite
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Folder of the suite [default: runs/FILE without its ending]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// GPUs, separated by commas: one run at a time on each [default: one run at a time]
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    gpus: Vec<String>,
    /// Seeds, separated by commas, of every run, in the place of those in the file
    #[arg(long, value_name = "LIST", value_delimiter = ',', value_parser = super::overrides::seed)]
    seed: Vec<u64>,
    /// Leave out the runs whose scores are in FILE, which `orchestrator report --table` keeps; a run that another begins
    /// with is made again
    #[arg(long, value_name = "FILE")]
    table: Option<PathBuf>,
    /// Only judge the file and print its runs, with their frames, what each writes at most, and how long they train
    #[arg(long)]
    check: bool,
    /// Print one JSON object: `runs`, each with `name`, `folder`, `status` and `tries`, the names of the `evaluations`,
    /// and the `page` of the report, if there is one; with --check without status and page
    #[arg(long)]
    json: bool,
}

pub fn run(args: &SuiteArgs) -> Result<ExitCode> {
    judged(check_gpus(&args.gpus))?;
    judged(check_seeds(&args.seed))?;
    let (mut suite, text) = judged(Suite::read(&args.file, &args.seed))?;
    if let Some(table) = &args.table {
        let kept = judged(files::read_table(table))?;
        suite.leave_out(&kept.runs());
        if suite.entries.is_empty() {
            terminal::out(&format!("nothing is left to run: {} has the scores of all", table.display()));
            return Ok(ExitCode::SUCCESS);
        }
    }
    let root = match &args.out {
        Some(out) => out.clone(),
        None => Path::new("runs").join(args.file.file_stem().context("the suite's file has no name")?),
    };
    let folder = SuiteFolder::new(&root);
    folder.check(&suite)?;
    judged(check_runs(&suite, &folder))?;
    for warning in suite.without_stage_one() {
        terminal::note(&warning);
    }
    if args.check {
        announce(&suite, &folder, args.json)?;
        return Ok(ExitCode::SUCCESS);
    }
    if !args.gpus.is_empty() {
        find_gpus(&args.gpus)?;
    }
    let _lock = folder.open(&suite, &text)?;
    let outcome = work(&suite, &folder, &args.gpus)?;
    let runs = standings(&suite, &folder)?;
    if !args.json {
        of_suite(&root, false)?;
    }
    let begun = begun(&root)?;
    let tell = |page: Option<PathBuf>| {
        let page = page.map(|page| page.display().to_string());
        if args.json {
            return terminal::out_json(&json!({ "runs": runs, "evaluations": names(&suite), "page": page }));
        }
        if let Some(page) = page {
            terminal::out(&format!("page: {page}"));
            let more = [("look", "view"), ("compare", "compare")];
            for (aim, command) in &more[..begun.len().min(2)] {
                terminal::out(&format!("{aim:11} {} {command} {}", program(), quoted(&root)));
            }
        }
        Ok(())
    };
    if let SuiteOutcome::Stopped | SuiteOutcome::Interrupted = outcome {
        tell(None)?;
        terminal::note(&format!("go on with: {}", again(args)));
        let stopped = outcome == SuiteOutcome::Stopped;
        return Ok(if stopped { ExitCode::SUCCESS } else { ExitCode::from(EXIT_INTERRUPTED) });
    }
    if begun.is_empty() {
        terminal::note("no run could be begun: there is nothing to report on");
        tell(None)?;
    } else {
        let (report, _) =
            files::write(gather(&begun, &[])?, &Options::default(), Some(folder.root()), &folder.report())?;
        if !args.json {
            super::report::print(&report);
        }
        for note in &report.notes {
            terminal::note(note);
        }
        tell(Some(folder.page()))?;
    }
    if outcome == SuiteOutcome::Done {
        return Ok(ExitCode::SUCCESS);
    }
    terminal::note(&format!(
        "some runs are not done; the same command tries them again (state: {})",
        folder.state().display()
    ));
    Ok(ExitCode::FAILURE)
}

fn names(suite: &Suite) -> Vec<String> {
    suite.evaluations.iter().map(Asked::folder).collect()
}

fn announce(suite: &Suite, folder: &SuiteFolder, as_json: bool) -> serde_json::Result<()> {
    if as_json {
        let run = |entry: &SuiteEntry| json!({ "name": entry.name, "folder": folder.run(entry).root() });
        let runs: Vec<_> = suite.entries.iter().map(run).collect();
        return terminal::out_json(&json!({ "runs": runs, "evaluations": names(suite) }));
    }
    let size = |entry: &SuiteEntry| [total_frames(&entry.config.stages), need(&entry.config).0 + need(&entry.config).1];
    let row = |entry: &SuiteEntry| {
        let [frames, disk] = size(entry);
        let from = entry.from.map_or_else(String::new, |from| format!("begins with {}", suite.entries[from].name));
        vec![entry.name.clone(), format!("{} frames", count(frames)), format!("at most {}", bytes(disk)), from]
    };
    for line in aligned(&suite.entries.iter().map(row).collect::<Vec<_>>()) {
        terminal::out(&line);
    }
    suite.apart().iter().for_each(|line| terminal::out_wrapped(line));
    let [frames, disk] = [0, 1].map(|which| suite.entries.iter().map(|entry| size(entry)[which]).sum());
    let (runs, frames, disk) = (counted(suite.entries.len() as u64, "run"), count(frames), bytes(disk));
    terminal::out(&format!(
        "{runs} in this order into {}: {frames} frames, at most {disk} on the disk",
        folder.root().display()
    ));
    let earlier = RunReaders::once(vec![folder.root().to_owned(), RUNS.into()]).list();
    terminal::out(&training_time(suite, &earlier));
    let evaluations = names(suite).join(", ");
    terminal::out(&if evaluations.is_empty() {
        "no [[evaluations]]: the report will have learning curves only".to_owned()
    } else {
        format!("evaluations of each run: {evaluations}")
    });
    Ok(())
}

/// How long the runs train one after another, by the newest earlier run of each preset; else by a round number.
fn training_time(suite: &Suite, earlier: &[Card]) -> String {
    let frames = |entry: &SuiteEntry| total_frames(&entry.config.stages) as f64;
    let speed = |SuiteEntry { preset, .. }: &SuiteEntry| {
        earlier.iter().find_map(|run| run.frames_per_s.filter(|_| run.preset == *preset))
    };
    let text = |seconds: f64| duration(Duration::try_from_secs_f64(seconds).unwrap_or_default());
    let known_s = suite.entries.iter().map(|entry| Some(frames(entry) / speed(entry)?)).sum::<Option<f64>>();
    if let Some(known_s) = known_s {
        return format!("about {} of training, as fast as earlier runs of the same presets", text(known_s));
    }
    let round = text(suite.entries.iter().map(frames).sum::<f64>() / 1000.0);
    let unknown = "no earlier run of these presets was found, so this machine's rate is not known";
    format!("at 1,000 frames/s that is {round} of training; {unknown}")
}

fn again(args: &SuiteArgs) -> String {
    let list = |values: &[String]| (!values.is_empty()).then(|| quoted(values.join(",")));
    let seeds: Vec<String> = args.seed.iter().map(u64::to_string).collect();
    let options = [
        ("--out", args.out.as_ref().map(quoted)),
        ("--gpus", list(&args.gpus)),
        ("--seed", list(&seeds)),
        ("--table", args.table.as_ref().map(quoted)),
    ];
    let options = options.into_iter().filter_map(|(name, value)| Some(format!(" {name} {}", value?)));
    let json = if args.json { " --json" } else { "" };
    format!("{} suite {}{}{json}", program(), quoted(&args.file), options.collect::<String>())
}

/// Refuses runs that could not begin, before the first does. A run that has begun has its own copy of its scenes.
fn check_runs(suite: &Suite, folder: &SuiteFolder) -> Result<()> {
    let mut sound: Vec<&[String]> = Vec::new();
    for entry in &suite.entries {
        let SuiteEntry { name, preset, config, .. } = entry;
        ensure!(
            !needs_environment(preset, config),
            "{name}: preset {preset} needs an environment of your own, which a suite cannot name: `up --env` can"
        );
        let scenes = config.scenes.as_slice();
        if !sound.contains(&scenes) && !folder.run(entry).identity().exists() {
            scenes::check(config).with_context(|| name.clone())?;
            sound.push(scenes);
        }
    }
    Ok(())
}

/// Refuses GPUs that torch does not find, in one sentence instead of one a run.
fn find_gpus(gpus: &[String]) -> Result<()> {
    let mut environment = libtorch::environment()?;
    environment.push((VISIBLE_DEVICES.into(), gpus.join(",").into()));
    let torch = libtorch::check(&programs::find("learner")?, &environment)?;
    device::check_gpus(gpus, &torch).demand()
}

fn check_gpus(gpus: &[String]) -> Result<()> {
    for (index, gpu) in gpus.iter().enumerate() {
        ensure!(!gpu.trim().is_empty(), "--gpus: an empty name in the list");
        ensure!(!gpus[..index].contains(gpu), "--gpus: {gpu} is given twice");
        let is_name = gpu.bytes().all(|letter| letter.is_ascii_digit())
            || ["GPU-", "MIG-"].iter().any(|start| gpu.starts_with(start));
        ensure!(is_name, "--gpus {gpu}: give numbers or UUIDs, as in --gpus 0,1; `nvidia-smi -L` lists them");
    }
    Ok(())
}

fn check_seeds(seeds: &[u64]) -> Result<()> {
    for (index, seed) in seeds.iter().enumerate() {
        ensure!(!seeds[..index].contains(seed), "--seed: {seed} is given twice");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::{Args, FromArgMatches};

    #[test]
    fn the_example_of_the_help_is_a_sound_file() {
        let suite = Suite::parse(EXAMPLE).unwrap();
        let names: Vec<&str> = suite.entries.iter().map(|entry| entry.name.as_str()).collect();
        let with_seeds = |name: &'static str| (1..=3).map(move |seed| format!("{name}-{seed}"));
        let stages = with_seeds("disturb-stage1-20m").chain(["small-steps-1".to_owned()]);
        let grid = ["0.1", "0.2"]
            .into_iter()
            .flat_map(|clip| ["0.0003", "0.001"].map(|rate| format!("rates-clip={clip}-learning_rate={rate}-1")));
        let expected = stages.chain(with_seeds("disturb-stage2-25m")).chain(grid);
        assert!(names.iter().copied().eq(expected), "{names:?}");
    }

    #[test]
    fn training_takes_as_long_as_earlier_runs_of_the_same_presets() {
        let suite = Suite::parse("seeds = [1, 2]\nframes = 60_000\n[[runs]]\npreset = \"demo\"\n").unwrap();
        let run = |preset: &str, frames_per_s| Card { preset: preset.to_owned(), frames_per_s, ..Card::default() };
        let earlier = [run("demo", None), run("demo", Some(800.0)), run("demo", Some(1.0))];
        let known = "about 2 min 30 s of training, as fast as earlier runs of the same presets";
        assert_eq!(training_time(&suite, &earlier), known);
        let unknown = "at 1,000 frames/s that is 2 min 00 s of training; no earlier run of these presets was found, so this \
                       machine's rate is not known";
        assert_eq!(training_time(&suite, &[run("paper", Some(800.0))]), unknown);
    }

    #[test]
    fn what_goes_on_is_the_same_call() {
        let call = |words: &[&str]| {
            let command = SuiteArgs::augment_args(clap::Command::new("suite").no_binary_name(true));
            again(&SuiteArgs::from_arg_matches(&command.get_matches_from(words)).unwrap())
        };
        let all =
            ["my suites/a.toml", "--out", "runs/all", "--gpus", "0,1", "--seed", "3,4", "--table", "t.json", "--json"];
        let expected = " suite 'my suites/a.toml' --out runs/all --gpus 0,1 --seed 3,4 --table t.json --json";
        assert!(call(&all).ends_with(expected), "{}", call(&all));
        assert!(call(&["a.toml"]).ends_with(" suite a.toml"), "{}", call(&["a.toml"]));
    }
}
