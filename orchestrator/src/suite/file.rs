//! The file of a suite: which presets with which seeds, and how they are evaluated. The whole file is checked before
//! anything starts.

use super::by_name;
use super::grid::{Point, points};
use super::in_words::{in_words, some_of};
use crate::evaluation::choice::{ObjectsChoice, SplitChoice, word};
use crate::evaluation::subject::network_differences;
use crate::output::format::{count, counted};
use crate::training::next_steps::without_stage_one;
use anyhow::{Context, Result, bail, ensure};
use proto::config::{Config, check_settings, overlay};
use proto::evaluation::has_targets;
use proto::stage::{TooFewFrames, scale_to};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use toml::{Table, Value};

const RUNS_MAX: usize = 1000;
/// Longest name of a run without its seed: file systems allow 255 bytes, and its folders and files add to it.
const NAME_BYTES_MAX: usize = 200;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(default)]
    seeds: Vec<u64>,
    /// Frames of the runs that name none: all stages are scaled in proportion.
    frames: Option<u64>,
    #[serde(default)]
    config: Table,
    #[serde(default)]
    evaluations: Vec<Asked>,
    runs: Vec<Planned>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Planned {
    preset: String,
    /// What its folders are called; the preset if it is not given.
    name: Option<String>,
    seeds: Option<Vec<u64>>,
    frames: Option<u64>,
    /// Name of runs further up: each seed begins with the weights that theirs ended with.
    from: Option<String>,
    #[serde(default)]
    config: Table,
    /// Keys, each with a list of values: every combination is a run, over the configuration.
    #[serde(default)]
    grid: Table,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AskedCheckpoint {
    #[default]
    Newest,
    Best,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Asked {
    pub split: SplitChoice,
    /// Of tasks without targets it is left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub objects: Option<ObjectsChoice>,
    /// Episodes of each kitchen and object set; all 360 if not given.
    pub episodes: Option<u32>,
    #[serde(default)]
    pub deterministic: bool,
    #[serde(default)]
    pub checkpoint: AskedCheckpoint,
}

#[derive(Debug, Clone, PartialEq)]
pub struct SuiteEntry {
    /// Name of its folder: `NAME-SEED`, of a grid's `NAME-KEY=VALUE-SEED`.
    pub name: String,
    pub preset: String,
    pub seed: u64,
    pub frames: Option<u64>,
    /// Number of the run before it in the suite whose weights it begins with.
    pub from: Option<usize>,
    pub overrides: String,
    pub config: Config,
}

#[derive(Debug, Clone, PartialEq)]
pub struct Suite {
    pub entries: Vec<SuiteEntry>,
    pub evaluations: Vec<Asked>,
}

impl Asked {
    pub fn folder(&self) -> String {
        let episodes = self.episodes.map_or_else(String::new, |episodes| format!("-{episodes}"));
        let deterministic = if self.deterministic { "-deterministic" } else { "" };
        let best = if self.checkpoint == AskedCheckpoint::Best { "-best" } else { "" };
        let objects = self.objects.map_or_else(String::new, |objects| format!("-{}", word(&objects)));
        format!("suite-{}{objects}{episodes}{deterministic}{best}", word(&self.split))
    }
}

impl Suite {
    /// Reads and judges a file, or a built-in one where only its name is given. If there are `seeds`, they take the place
    /// of all in the file, in the text that is returned as well.
    pub fn read(path: &Path, seeds: &[u64]) -> Result<(Self, String)> {
        let text = by_name::text(path)?;
        let is_toml = path.extension().is_none_or(|ending| ending == "toml") || text.parse::<Table>().is_ok();
        let named = format!("{}{}", path.display(), if is_toml { "" } else { ": it must be TOML" });
        let named = || named.clone();
        let text = if seeds.is_empty() { text } else { with_seeds(&text, seeds).with_context(named)? };
        let suite = Self::parse(&text).with_context(named)?;
        Ok((suite, text))
    }

    pub fn parse(text: &str) -> Result<Self> {
        let file: File = toml::from_str(text).map_err(|error| in_words(text, &error))?;
        ensure!(!file.runs.is_empty(), "no [[runs]]: a suite has at least one");
        check_keys(&file.config).context("for every run")?;
        let mut entries = Vec::new();
        for (index, planned) in file.runs.iter().enumerate() {
            let named = planned.name.as_ref().map_or_else(String::new, |name| format!(" `{name}`,"));
            let called = || format!("[[runs]] number {},{named} preset `{}`", index + 1, planned.preset);
            let more = planned.entries(&file, &entries).with_context(called)?;
            entries.extend(more);
        }
        ensure!(entries.len() <= RUNS_MAX, "{} runs; a suite has at most {RUNS_MAX}", entries.len());
        distinct(&entries)?;
        for (index, asked) in file.evaluations.iter().enumerate() {
            if let Some(episodes) = asked.episodes {
                ensure!(
                    (1..=360).contains(&episodes),
                    "[[evaluations]] number {}: episodes = {episodes}; a kitchen has 1 to 360 of each object set",
                    index + 1
                );
            }
            if let (Some(_), Some(entry)) =
                (asked.objects, entries.iter().find(|entry| !has_targets(entry.config.spec())))
            {
                bail!(
                    "[[evaluations]] number {}: leave out `objects`: an episode of {} has no target",
                    index + 1,
                    entry.name
                );
            }
            if let Some(same) = file.evaluations[..index].iter().position(|before| before == asked) {
                bail!("[[evaluations]] number {} repeats number {}", index + 1, same + 1);
            }
            let without = entries.iter().find(|entry| entry.config.validation.every_frames == 0);
            if let (AskedCheckpoint::Best, Some(entry)) = (asked.checkpoint, without) {
                bail!(
                    "[[evaluations]] number {}: checkpoint = \"best\", but {} is not validated while it trains: set \
                     config.validation.every_frames, the frames from one validation to the next",
                    index + 1,
                    entry.name
                );
            }
        }
        Ok(Self { entries, evaluations: file.evaluations })
    }

    /// Runs that begin with stage II and no weights of a stage I, each once, whatever its seeds.
    pub fn without_stage_one(&self) -> BTreeSet<String> {
        let alone = self.entries.iter().filter(|entry| entry.from.is_none());
        alone
            .filter_map(|entry| {
                without_stage_one(&entry.config, |stage| format!("`from = \"{stage}\"`, a run further up"))
            })
            .collect()
    }

    /// What tells the runs apart beside preset and seed, a line for each kind of them: the keys of the file that not all have
    /// alike, unless a grid's name says them.
    pub fn apart(&self) -> Vec<String> {
        let keys = |entry: &SuiteEntry| toml::from_str::<Table>(&entry.overrides).unwrap_or_default();
        let settings = |keys: Table| -> BTreeSet<String> {
            let (paths, keys) = (leaves(&keys), Value::Table(keys));
            let value = |path: &str| path.split('.').try_fold(&keys, |value, key| value.get(key));
            paths.iter().filter_map(|(path, _)| Some(format!("{path} = {}", value(path)?))).collect()
        };
        let all: Vec<BTreeSet<String>> = self.entries.iter().map(keys).map(settings).collect();
        let line = |(entry, own): (&SuiteEntry, &BTreeSet<String>)| {
            let kind = entry.name.strip_suffix(&format!("-{}", entry.seed))?;
            let is_said =
                |setting: &str| kind.contains(&setting.rsplit('.').next().unwrap_or(setting).replace(" = ", "="));
            let is_own = |setting: &&String| !all.iter().all(|other| other.contains(*setting)) && !is_said(setting);
            let apart: Vec<&str> = own.iter().filter(is_own).map(String::as_str).collect();
            (!apart.is_empty()).then(|| format!("{kind}: {}", apart.join(", ")))
        };
        let mut lines: Vec<String> = self.entries.iter().zip(&all).filter_map(line).collect();
        lines.dedup();
        lines
    }

    /// Leaves out what is in a table already.
    pub fn leave_out(&mut self, done: &BTreeSet<&str>) {
        let mut kept = vec![false; self.entries.len()];
        for (index, entry) in self.entries.iter().enumerate().rev() {
            kept[index] |= !done.contains(entry.name.as_str());
            if let (true, Some(from)) = (kept[index], entry.from) {
                kept[from] = true;
            }
        }
        let number = |old: usize| kept[..old].iter().filter(|kept| **kept).count();
        for entry in &mut self.entries {
            entry.from = entry.from.map(number);
        }
        let mut is_kept = kept.iter();
        self.entries.retain(|_| is_kept.next() == Some(&true));
    }
}

impl Planned {
    fn entries(&self, file: &File, before: &[SuiteEntry]) -> Result<Vec<SuiteEntry>> {
        let name = self.name.as_ref().unwrap_or(&self.preset);
        let sound = |letter: char| letter.is_ascii_alphanumeric() || "-_.".contains(letter);
        ensure!(
            !name.is_empty() && name.chars().all(sound) && !name.starts_with(['.', '-']),
            "name = \"{name}\": a name is letters, digits, `-`, `_` and `.`, and begins with a letter or digit"
        );
        let seeds = self.seeds.as_ref().unwrap_or(&file.seeds);
        ensure!(!seeds.is_empty(), "no seeds: give the run `seeds`, or the suite");
        // Before a run is made for each.
        ensure!(seeds.len() <= RUNS_MAX, "{} seeds; a suite has at most {RUNS_MAX} runs", seeds.len());
        if let Some(twice) = (1..seeds.len()).find(|&index| seeds[..index].contains(&seeds[index])) {
            bail!("seeds = {seeds:?}: {} is given twice", seeds[twice]);
        }
        check_keys(&self.config)?;
        let mut keys = file.config.clone();
        overlay(&mut keys, self.config.clone());
        let mut entries = Vec::new();
        for Point { suffix, settings } in points(&self.grid, RUNS_MAX)? {
            let mut keys = keys.clone();
            for setting in &settings {
                setting.lay_over(&mut keys);
            }
            let name = format!("{name}{suffix}");
            ensure!(
                name.len() <= NAME_BYTES_MAX,
                "{name} is too long for a folder's name: give the run a shorter `name`"
            );
            let more = self.with_keys(&name, &keys, seeds, file.frames, before);
            // Without a grid the name adds nothing.
            let runs = before.len() + entries.len() + seeds.len();
            ensure!(runs <= RUNS_MAX, "{runs} runs so far; a suite has at most {RUNS_MAX}");
            let more = if suffix.is_empty() { more } else { more.with_context(|| format!("grid: {name}")) };
            entries.extend(more?);
        }
        Ok(entries)
    }

    fn with_keys(
        &self,
        name: &str,
        keys: &Table,
        seeds: &[u64],
        frames: Option<u64>,
        before: &[SuiteEntry],
    ) -> Result<Vec<SuiteEntry>> {
        let overrides = toml::to_string(keys).context("config")?;
        let frames = self.frames.or(frames);
        let mut config = Config::resolve_with(&self.preset, Some((&overrides, "config")))?;
        config.validate()?;
        if let Some(frames) = frames {
            let steps = u64::from(config.ppo.rollout_steps) * config.stages.len() as u64;
            let least = config.environments() as u64 * steps;
            ensure!(frames >= least, "frames = {frames}: it needs at least {}, a rollout for each stage", count(least));
            let too_few = |TooFewFrames { total, stages }| {
                anyhow::anyhow!("frames = {total} is too few for {}", counted(stages as u64, "stage"))
            };
            config.stages = scale_to(&config.stages, frames).map_err(too_few)?;
            config.validate()?;
        }
        let entry = |&seed: &u64| {
            let from = self.from.as_ref().map(|from| {
                let found = source(&format!("{from}-{seed}"), &config, before);
                found.with_context(|| format!("from = \"{from}\""))
            });
            let from = from.transpose()?;
            Ok(SuiteEntry {
                name: format!("{name}-{seed}"),
                preset: self.preset.clone(),
                seed,
                frames,
                from,
                overrides: overrides.clone(),
                config: Config { seed, ..config.clone() },
            })
        };
        seeds.iter().map(entry).collect()
    }
}

/// Refuses keys that have their place elsewhere in the file, and keys and values that no configuration has. A key is
/// named as the user wrote it: the line number of an error would be that of a text which the user has not written.
fn check_keys(keys: &Table) -> Result<()> {
    let elsewhere = [
        ("seed", "`seeds`"),
        ("frames", "`frames` of the run, or of the suite"),
        ("preset", "`preset` of the run"),
        ("from", "`from` of the run"),
        ("evaluation", "[[evaluations]]"),
    ];
    for (key, instead) in elsewhere {
        if keys.contains_key(key) {
            bail!("config.{key}: set it by {instead}");
        }
    }
    for (path, alone) in leaves(keys) {
        // Whether a value is in its range may depend on the preset and on other keys.
        check_settings(&alone).with_context(|| format!("config.{path}"))?;
    }
    Ok(())
}

fn with_seeds(text: &str, seeds: &[u64]) -> Result<String> {
    let mut file: Table = toml::from_str(text).map_err(|error| in_words(text, &error))?;
    let numbers = seeds.iter().map(|&seed| i64::try_from(seed).map(Value::Integer)).collect::<Result<_, _>>();
    let numbers = numbers.context("--seed: TOML has no number as large")?;
    file.insert("seeds".to_owned(), Value::Array(numbers));
    let runs = file.get_mut("runs").and_then(Value::as_array_mut).into_iter().flatten();
    for run in runs.filter_map(Value::as_table_mut) {
        run.remove("seeds");
    }
    toml::to_string(&file).context("the suite with --seed")
}

fn leaves(table: &Table) -> Vec<(String, Table)> {
    let mut found = Vec::new();
    for (key, value) in table {
        let mut put = |path: String, value: Value| found.push((path, Table::from_iter([(key.clone(), value)])));
        match value {
            Value::Table(inner) if !inner.is_empty() => {
                for (path, alone) in leaves(inner) {
                    put(format!("{key}.{path}"), Value::Table(alone));
                }
            }
            value => put(key.clone(), value.clone()),
        }
    }
    found
}

fn source(name: &str, config: &Config, before: &[SuiteEntry]) -> Result<usize> {
    let found = before.iter().position(|entry| entry.name == name);
    let found = found.with_context(|| format!("no run further up in the file is called {name}"))?;
    let differences = network_differences(&before[found].config, config)?;
    let keys = differences.iter().filter_map(|difference| difference.split(' ').next());
    ensure!(
        differences.is_empty(),
        "{name} trains another network: give both runs the same {}",
        some_of(keys.map(str::to_owned).collect())
    );
    Ok(found)
}

fn distinct(entries: &[SuiteEntry]) -> Result<()> {
    let mut names: BTreeMap<&str, usize> = BTreeMap::new();
    // Two presets may be one experiment.
    let nameless = |entry: &SuiteEntry| (Config { preset: String::new(), ..entry.config.clone() }, entry.from);
    let runs: Vec<(Config, Option<usize>)> = entries.iter().map(nameless).collect();
    for (index, entry) in entries.iter().enumerate() {
        if names.insert(&entry.name, index).is_some() {
            bail!("two runs are called {}: give one of them another `name`, or other seeds", entry.name);
        }
        if let Some(same) = runs[..index].iter().position(|before| *before == runs[index]) {
            bail!(
                "{} and {} are the same run, with the same settings and seed: leave one of them out",
                entries[same].name,
                entry.name
            );
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn problem(text: &str) -> String {
        format!("{:#}", Suite::parse(text).unwrap_err())
    }

    #[test]
    fn a_wrong_line_is_shown_with_what_it_needs_in_plain_words() {
        let run = "each run begins with a line [[runs]], and below it preset = \"demo\"";
        assert_eq!(problem(""), format!("missing key `runs`: {run}"));
        for (text, said) in [
            ("seeds = [\"a\"]", "line 1, `seeds = [\"a\"]`: expected a whole number, 0 or greater, found \"a\""),
            ("seeds = # one", "line 1, `seeds = # one`: the value after `=` is missing: a list of whole numbers"),
            ("seeds = [1]\nframes = -5", "`frames = -5`: expected a whole number, 1 or greater, found `-5`"),
            ("seeds = [1]\nframes = 1.5", "line 2, `frames = 1.5`: expected a whole number, 1 or greater, found `1.5`"),
            (
                "seeds = 1",
                "line 1, `seeds = 1`: expected a list, found `1`: a list of whole numbers, as in seeds = [1, 2]",
            ),
            ("[[runs]]\nname = \"x\"", "line 1, `[[runs]]`: missing key `preset`"),
            ("runs = [\"demo\"]", run),
            ("[runs]\npreset = \"demo\"", run),
            ("seeds = [1]", run),
            (
                "evaluations = [\"test\"]\n[[runs]]\npreset = \"demo\"",
                "a line [[evaluations]], and below it split = \"test\"",
            ),
            ("frames = \"1M\"\n[[runs]]\npreset = \"demo\"", "write frames = 1000000"),
            ("frames = 1e6\n[[runs]]\npreset = \"demo\"", "write frames = 1000000"),
            ("[[runs]]\npreset = \"demo\"\nppo.clip = 0.2", "a setting is written config.ppo.clip = 0.2"),
            ("[ppo]\nclip = 0.2", "`orchestrator up --config FILE` takes a configuration"),
            (
                "evaluations = [{ split = \"tset\", objects = \"all\" }]",
                "unknown value `tset`, expected one of `train`, `validation`, `test`",
            ),
        ] {
            let problem = problem(text);
            assert!(problem.contains(said), "{problem}");
        }
    }

    #[test]
    fn a_second_stage_without_from_is_told_of_once() {
        let stages = "seeds = [1, 2]\n[[runs]]\npreset = \"none-stage1-20m\"\n[[runs]]\npreset = \"none-stage2-25m\"\n";
        let told = Suite::parse(stages).unwrap().without_stage_one();
        assert_eq!(told.len(), 1, "{told:?}");
        assert!(told.first().unwrap().contains("give it `from = \"none-stage1-20m\"`, a run further up"), "{told:?}");
        let with = format!("{stages}from = \"none-stage1-20m\"\n");
        assert!(Suite::parse(&with).unwrap().without_stage_one().is_empty());
    }

    #[test]
    fn presets_times_seeds_with_the_suites_settings_beneath_the_runs() {
        let suite = Suite::parse(
            r#"
            seeds = [1, 2]
            frames = 9000
            [config.ppo]
            epochs = 2
            clip = 0.3
            [[evaluations]]
            split = "test"
            objects = "novel"
            episodes = 6
            [[evaluations]]
            split = "validation"
            objects = "all"
            deterministic = true
            [[runs]]
            preset = "demo"
            [[runs]]
            preset = "demo"
            name = "wide"
            seeds = [7]
            frames = 4500
            config.ppo.clip = 0.2
            "#,
        )
        .unwrap();
        let names: Vec<&str> = suite.entries.iter().map(|entry| entry.name.as_str()).collect();
        assert_eq!(names, ["demo-1", "demo-2", "wide-7"]);
        let [first, _, wide] = suite.entries.as_slice() else { panic!("three") };
        assert_eq!((first.config.ppo.epochs, first.config.ppo.clip, first.config.seed), (2, 0.3, 1));
        assert_eq!((wide.config.ppo.epochs, wide.config.ppo.clip, wide.config.seed), (2, 0.2, 7));
        let frames = |entry: &SuiteEntry| entry.config.stages.iter().map(|stage| stage.frames).sum::<u64>();
        assert_eq!((frames(first), frames(wide)), (9000, 4500));
        let folders: Vec<String> = suite.evaluations.iter().map(Asked::folder).collect();
        assert_eq!(folders, ["suite-test-novel-6", "suite-validation-all-deterministic"]);
        assert!(suite.entries.iter().all(|entry| entry.from.is_none()));
        // What the child is given comes to the same.
        let again = Config::resolve_with("demo", Some((&wide.overrides, "file"))).unwrap();
        assert_eq!(Config { stages: wide.config.stages.clone(), seed: 7, ..again }, wide.config);
    }

    #[test]
    fn a_grid_is_a_run_for_each_combination_and_seed() {
        let text = r#"
            seeds = [1, 2]
            config.ppo.clip = 0.3
            [[runs]]
            preset = "demo"
            name = "first"
            config.ppo.epochs = 3
            grid = { "ppo.learning_rate" = [3e-4, 1e-3], "ppo.clip" = [0.1] }
            [[runs]]
            preset = "demo"
            name = "second"
            from = "first-clip=0.1-learning_rate=0.001"
            [runs.grid]
            ppo.epochs = [7, 8]
            "#;
        let suite = Suite::parse(text).unwrap();
        let names: Vec<&str> = suite.entries.iter().map(|entry| entry.name.as_str()).collect();
        assert_eq!(
            names,
            [
                "first-clip=0.1-learning_rate=0.0003-1",
                "first-clip=0.1-learning_rate=0.0003-2",
                "first-clip=0.1-learning_rate=0.001-1",
                "first-clip=0.1-learning_rate=0.001-2",
                "second-epochs=7-1",
                "second-epochs=7-2",
                "second-epochs=8-1",
                "second-epochs=8-2",
            ]
        );
        // The names say the rest.
        assert_eq!(
            suite.apart(),
            [
                "first-clip=0.1-learning_rate=0.0003: ppo.epochs = 3",
                "first-clip=0.1-learning_rate=0.001: ppo.epochs = 3",
                "second-epochs=7: ppo.clip = 0.3",
                "second-epochs=8: ppo.clip = 0.3"
            ]
        );
        let third = &suite.entries[2];
        let ppo = third.config.ppo;
        assert_eq!((ppo.learning_rate, ppo.clip, ppo.epochs, third.seed), (1e-3, 0.1, 3, 1));
        assert_eq!((suite.entries[6].from, suite.entries[7].from), (Some(2), Some(3)));
        // What the child is given comes to the same.
        let again = Config::resolve_with("demo", Some((&third.overrides, "file"))).unwrap();
        assert_eq!(Config { seed: 1, ..again }, third.config);

        let unknown = problem(&text.replace("ppo.clip\" = [0.1]", "ppo.clib\" = [0.1]"));
        assert!(unknown.contains("`first`, preset `demo`: grid.ppo.clib: unknown key `clib`"), "{unknown}");
        let range = problem(&text.replace("[7, 8]", "[7, 0]"));
        assert!(range.contains("grid: second-epochs=0: configuration: ppo.epochs = 0"), "{range}");
    }

    #[test]
    fn seeds_of_the_command_line_take_the_place_of_the_files() {
        let text = "seeds = [1, 2]\n[[runs]]\npreset = \"demo\"\n[[runs]]\npreset = \"paper\"\nseeds = [9]\n";
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("suite.toml");
        std::fs::write(&path, text).unwrap();
        let names = |suite: &Suite| suite.entries.iter().map(|entry| entry.name.clone()).collect::<Vec<_>>();
        let (suite, written) = Suite::read(&path, &[7, 8]).unwrap();
        assert_eq!(names(&suite), ["demo-7", "demo-8", "paper-7", "paper-8"]);
        assert_eq!(names(&Suite::parse(&written).unwrap()), names(&suite), "the text goes on with the same runs");
        let (suite, written) = Suite::read(&path, &[]).unwrap();
        assert_eq!((names(&suite).len(), written.as_str()), (3, text));
        // A file without seeds is made whole by them.
        std::fs::write(&path, "[[runs]]\npreset = \"demo\"\n").unwrap();
        assert_eq!(names(&Suite::read(&path, &[3]).unwrap().0), ["demo-3"]);
    }

    #[test]
    fn a_run_begins_with_the_weights_of_the_same_seed_further_up() {
        let stage_1 = "[[runs]]\npreset = \"short-r-only\"\nname = \"stage-1\"\n";
        let stage_2 = "[[runs]]\npreset = \"short-scratch\"\nfrom = \"stage-1\"\n";
        let scratch = "[[runs]]\npreset = \"short-scratch\"\nname = \"scratch\"\n";
        let suite = Suite::parse(&format!("seeds = [1, 2]\n{stage_1}{stage_2}{scratch}")).unwrap();
        let from: Vec<Option<usize>> = suite.entries.iter().map(|entry| entry.from).collect();
        assert_eq!(
            from,
            [None, None, Some(0), Some(1), None, None],
            "and begun so it is another run than from scratch"
        );
        let later = problem(&format!("seeds = [1]\n{stage_2}{stage_1}"));
        assert!(later.contains("no run further up in the file is called stage-1-1"), "{later}");
        let other_seed = problem(&format!("seeds = [1]\n{stage_1}{stage_2}seeds = [2]\n"));
        assert!(other_seed.contains("is called stage-1-2"), "{other_seed}");
        let other = problem(&format!("seeds = [1]\n{stage_1}{stage_2}config.network.hidden = 256\n"));
        assert!(other.ends_with("stage-1-1 trains another network: give both runs the same network.hidden"), "{other}");
        let gym = problem(&format!("seeds = [1]\n{stage_1}[[runs]]\npreset = \"gym\"\nfrom = \"stage-1\"\n"));
        assert!(gym.contains(" more") && gym.len() < 200, "{gym}");
    }

    #[test]
    fn the_best_checkpoint_can_be_asked_for_where_there_is_one() {
        let best = "[[evaluations]]\nsplit = \"test\"\nobjects = \"novel\"\ncheckpoint = \"best\"\n";
        let newest = best.replace("best", "newest");
        let runs = "[[runs]]\npreset = \"lambda-1\"\n[[runs]]\npreset = \"demo\"\n";
        let validated = "config.validation.every_frames = 90\n";
        let suite = Suite::parse(&format!("seeds = [1]\n{newest}{best}{runs}{validated}")).unwrap();
        let folders: Vec<String> = suite.evaluations.iter().map(Asked::folder).collect();
        assert_eq!(folders, ["suite-test-novel", "suite-test-novel-best"]);
        let problem = problem(&format!("seeds = [1]\n{best}{runs}"));
        assert!(problem.contains("number 1: checkpoint = \"best\", but demo-1 is not validated"), "{problem}");
    }

    #[test]
    fn mistakes_are_found_before_anything_starts() {
        let objects = "[[evaluations]]\nsplit = \"test\"\nobjects = \"novel\"\n";
        let of = |preset: &str| format!("[[runs]]\npreset = \"{preset}\"\n");
        let demo = of("demo");
        for (text, said) in [
            (
                format!("{objects}{}", of("point-nav-demo")),
                "number 1: leave out `objects`: an episode of point-nav-demo-1 has no target",
            ),
            (format!("{demo}{}", of("demmo")), "number 2"),
            (format!("{demo}{}", of("demmo")), "did you mean `demo`?"),
            (format!("{demo}{demo}"), "two runs are called demo-1"),
            (format!("{objects}{objects}{demo}"), "[[evaluations]] number 2 repeats number 1"),
            (format!("{demo}{demo}name = \"x\"\n"), "demo-1 and x-1 are the same run"),
            (format!("{demo}config.ppo.lerning_rate = 1.0\n"), "lerning_rate"),
            (format!("{demo}config.ppo.lerning_rate = 1.0\n"), "did you mean `learning_rate`?"),
            (format!("{demo}config.seed = 3\n"), "`seeds`"),
            (format!("{demo}name = \"../x\"\n"), "../x"),
            (format!("sped = 2\n{demo}"), "sped"),
            (of("lambda-15") + &of("disturb-two-stage"), "lambda-15-1 and disturb-two-stage-1 are the same run"),
            (format!("{}episodes = 361\n{demo}", objects.replace("novel", "all")), "361"),
        ] {
            let problem = problem(&format!("seeds = [1]\n{text}"));
            assert!(problem.contains(said), "{said}: {problem}");
        }
        assert!(problem("runs = []").contains("at least one") && problem(&demo).contains("no seeds"));
        assert!(problem("runs = []\nsedes = [1]\n").ends_with("(did you mean `seeds`?)"));
        let few = "[[runs]] number 1, preset `demo`: frames = 1: it needs at least 2,432, a rollout for each stage";
        assert_eq!(problem(&format!("seeds = [1]\nframes = 1\n{demo}")), few);
        assert!(problem(&format!("seeds = [3, 1, 3]\n{demo}")).ends_with("seeds = [3, 1, 3]: 3 is given twice"));
        // Refused before a run is made for each seed: a million would take minutes and the machine's memory.
        let began = std::time::Instant::now();
        let seeds: Vec<String> = (0..1_000_000).map(|seed: u32| seed.to_string()).collect();
        let many = problem(&format!("seeds = [{}]\n{demo}", seeds.join(",")));
        assert!(many.contains("1000000 seeds; a suite has at most"), "{many}");
        assert!(began.elapsed().as_secs() < 30);
        let each = format!("{demo}grid = {{ \"ppo.epochs\" = [1, 2, 3, 4] }}\n");
        let many = problem(&format!("seeds = [{}]\n{each}", seeds[..900].join(",")));
        assert!(many.contains("runs so far; a suite has at most"), "{many}");
    }

    #[test]
    fn what_a_table_has_is_left_out_unless_another_begins_with_it() {
        let first = "[[runs]]\npreset = \"short-r-only\"\nname = \"stage-1\"\n";
        let second = "[[runs]]\npreset = \"short-scratch\"\nname = \"stage-2\"\nfrom = \"stage-1\"\n";
        let whole = Suite::parse(&format!("seeds = [1, 2]\n{first}{second}")).unwrap();
        let left = |done: &[&str]| {
            let mut suite = whole.clone();
            suite.leave_out(&done.iter().copied().collect());
            suite.entries.into_iter().map(|entry| (entry.name, entry.from)).collect::<Vec<_>>()
        };
        let named = |name: &str, from| (name.to_owned(), from);
        let all = [("stage-1-1", None), ("stage-1-2", None), ("stage-2-1", Some(0)), ("stage-2-2", Some(1))];
        assert_eq!(left(&[]), all.map(|(name, from)| named(name, from)));
        assert_eq!(
            left(&["stage-1-1", "stage-2-1", "stage-1-2"]),
            [named("stage-1-2", None), named("stage-2-2", Some(0))]
        );
        assert_eq!(left(&["stage-1-1", "stage-1-2", "stage-2-1", "stage-2-2"]), []);
    }
}
