//! What run folders and evaluation folders tell, for a report.

use crate::identity::{Identity, holder, state};
use crate::metrics::{History, Trained};
use crate::summary::Summary;
use crate::validation::{Validated as Scored, read_log};
use anyhow::{Context, Result, bail};
use proto::SCHEMA_VERSION;
use proto::config::Config;
use proto::evaluation::{Evaluation, RESULT_FILE, TABLE_FILE, read_table};
use proto::run_folder::RunFolder;
use report::study::{Evaluated, Rollout, Run, UNTRAINED, Validated};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// How deep below a given folder runs are looked for.
const DEPTH: usize = 3;

/// The runs meant by `paths`: run folders, evaluation folders, or folders that hold runs. Evaluations of a given run go
/// to that run; others stand for themselves.
pub fn gather(paths: &[PathBuf]) -> Result<Vec<Run>> {
    let mut runs: Vec<(PathBuf, Run)> = Vec::new();
    let mut evaluations = Vec::new();
    for path in paths {
        let mut found = Vec::new();
        look(path, DEPTH, &mut found).with_context(|| path.display().to_string())?;
        if found.is_empty() {
            bail!("{} is no run and holds none (a run has a run.toml)", path.display());
        }
        for folder in found {
            let place = std::fs::canonicalize(&folder).with_context(|| folder.display().to_string())?;
            if folder.join(RESULT_FILE).exists() {
                if !evaluations.iter().any(|(known, _)| *known == place) {
                    evaluations.push((place, folder));
                }
            } else if !runs.iter().any(|(known, _)| *known == place) {
                runs.push((place, run(&folder)?));
            }
        }
    }
    for (place, folder) in evaluations {
        let evaluated = evaluation(&folder)?;
        let of = evaluated.result.subject.run.as_ref().and_then(|run| std::fs::canonicalize(run).ok());
        match runs.iter_mut().find(|(known, _)| Some(known) == of.as_ref()) {
            // Its own evaluations are known already.
            Some((known, _)) if place.starts_with(&*known) => {}
            Some((_, run)) => run.evaluations.push(evaluated),
            None => runs.push((place, alone(&folder, evaluated)?)),
        }
    }
    Ok(runs.into_iter().map(|(_, run)| run).collect())
}

/// Run and evaluation folders at or below `folder`; what lies inside of one is its own affair.
fn look(folder: &Path, depth: usize, found: &mut Vec<PathBuf>) -> Result<()> {
    let has_result = folder.join(RESULT_FILE).exists();
    if has_result || RunFolder::new(folder).identity().exists() {
        // A run.toml whose configuration holds an evaluation is one without a result.
        if has_result || config(folder)?.evaluation.is_none() {
            found.push(folder.to_path_buf());
        }
        return Ok(());
    }
    if depth == 0 {
        return Ok(());
    }
    let mut below = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            below.push(path);
        }
    }
    below.sort();
    below.iter().try_for_each(|path| look(path, depth - 1, found))
}

fn config(folder: &Path) -> Result<Config> {
    let path = RunFolder::new(folder).config();
    let text = std::fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
    Ok(Config::from_toml(&text, &path.display().to_string())?)
}

fn run(path: &Path) -> Result<Run> {
    let folder = RunFolder::new(path);
    let identity = Identity::read(&folder)?;
    let complete = Summary::read(&folder)?.is_some();
    let history = History::read(&folder)?;
    let rollout = |trained: &Trained| Rollout { frames: trained.frames, metrics: trained.metrics.clone() };
    Ok(Run {
        name: path.display().to_string(),
        state: state(&identity, &holder(&folder)?, complete),
        config: config(path)?,
        rollouts: history.iter().map(rollout).collect(),
        evaluations: evaluations_of(&folder)?,
        validation: validation_of(&folder)?,
    })
}

/// Evaluations during training, in order of frames. A checkpoint that was evaluated twice, because a crash came between
/// the result and its line, counts once.
fn validation_of(folder: &RunFolder) -> Result<Vec<Validated>> {
    let mut by_frames = BTreeMap::new();
    for line in read_log(&folder.validation_log())? {
        let Scored { frames, success, success_without_disturbance, .. } = line;
        by_frames.insert(frames, Validated { frames, success, success_without_disturbance });
    }
    Ok(by_frames.into_values().collect())
}

/// The evaluations in a run's own folder, oldest first.
fn evaluations_of(folder: &RunFolder) -> Result<Vec<Evaluated>> {
    let below = folder.root().join("evaluations");
    let mut paths = Vec::new();
    if below.is_dir() {
        for entry in std::fs::read_dir(&below).with_context(|| below.display().to_string())? {
            let path = entry?.path();
            // One that was cut off has no result.
            if path.join(RESULT_FILE).exists() {
                paths.push(path);
            }
        }
    }
    paths.sort();
    paths.iter().map(|path| evaluation(path)).collect()
}

fn evaluation(folder: &Path) -> Result<Evaluated> {
    let read = |name: &str| {
        let path = folder.join(name);
        std::fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))
    };
    let text = read(RESULT_FILE)?;
    let damaged = || format!("{} is damaged", folder.join(RESULT_FILE).display());
    // The version first: what a later one holds cannot be read by this one's rules.
    let value: serde_json::Value = serde_json::from_str(&text).with_context(damaged)?;
    let version = value["schema_version"].as_u64();
    if version != Some(u64::from(SCHEMA_VERSION)) {
        bail!(
            "{} is of schema {}; this program reads schema {SCHEMA_VERSION}: evaluate again",
            folder.join(RESULT_FILE).display(),
            version.map_or_else(|| "unknown".to_owned(), |version| version.to_string())
        );
    }
    let result: Evaluation = serde_json::from_value(value).with_context(damaged)?;
    let episodes = read_table(&read(TABLE_FILE)?).with_context(|| format!("{}", folder.join(TABLE_FILE).display()))?;
    if result.overall.episodes != episodes.len() as u64 {
        bail!(
            "{}: the table has {} episodes, the result file {}",
            folder.display(),
            episodes.len(),
            result.overall.episodes
        );
    }
    let name = folder.file_name().map_or_else(|| folder.display().to_string(), |name| name.to_string_lossy().into());
    Ok(Evaluated { name, result, episodes })
}

/// An evaluation whose run is not given, or that has none.
fn alone(folder: &Path, evaluated: Evaluated) -> Result<Run> {
    let mut config = config(folder)?;
    let subject = &evaluated.result.subject;
    // The configuration is the evaluation's: its own seed, its own number of actors.
    config.seed = subject.seed;
    config.evaluation = None;
    if let Ok(preset) = Config::resolve(&config.preset, None) {
        config.actors = preset.actors;
    }
    let state = if subject.run.is_none() { UNTRAINED } else { "its run was not given" };
    Ok(Run {
        name: folder.display().to_string(),
        state: state.to_owned(),
        config,
        rollouts: Vec::new(),
        evaluations: vec![evaluated],
        validation: Vec::new(),
    })
}
