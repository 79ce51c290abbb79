//! Whose weights: what a user's path means.
//!
//! A run folder means its newest checkpoint that is whole; a manifest (or the tensors beside it) that checkpoint;
//! `RUN/best` the best one. The configuration is the one beside the checkpoint, or that of the run folder it lies in
//! (`RUN/checkpoints/`, `RUN/validation/rollout-K/`, `RUN/best/`). A policy file, which `orchestrator export` writes, holds
//! all of it itself.

use crate::run::checkpoints::newest_whole;
use crate::run::identity::perhaps;
use crate::wrong::{demand, reject, wrong};
use anyhow::{Context, Result, anyhow, bail};
use export::{Policy, PolicyError};
use proto::config::{Config, presets};
use proto::run_folder::{RolloutName, RunFolder};
use proto::shell::quoted;
use proto::task::Image;
use serde_json::json;
use std::path::{Path, PathBuf};

#[derive(Debug, Clone)]
pub struct Found {
    pub manifest: PathBuf,
    /// The folder that the user named, or that the manifest lies in.
    pub named: RunFolder,
    /// Absolute path of the folder that the configuration was found in.
    pub run: PathBuf,
    pub config: Config,
}

#[derive(Debug)]
pub enum Source {
    Checkpoint(Box<Found>),
    File { path: PathBuf, policy: Box<Policy> },
}

impl Source {
    pub fn config(&self) -> &Config {
        match self {
            Self::Checkpoint(found) => &found.config,
            Self::File { policy, .. } => &policy.config,
        }
    }

    pub fn checkpoint(self) -> Result<Found> {
        match self {
            Self::Checkpoint(found) => Ok(*found),
            Self::File { path, .. } => bail!(
                "{} is a policy file, not a checkpoint: `orchestrator import {} --run DIR --preset P` makes a run that \
                 begins with its weights",
                path.display(),
                quoted(&path)
            ),
        }
    }
}

/// The key of a network's table that changes no weight's shape, and what it means to change it.
const SIGN: &str = "carried_goal";
const SIGN_HINT: &str = " (while the target is held, those weights would see their goal in the opposite direction: give \
                         the run their network.carried_goal, in a file for --config)";

/// What keeps weights trained with one configuration from being begun with in another, as `key is X, there Y`; nothing
/// where the networks are the same.
pub fn network_differences(theirs: &Config, ours: &Config) -> Result<Vec<String>> {
    let network = |config: &Config| toml::Table::try_from(&config.network).context("the table [network] is plain data");
    let (their_network, our_network) = (network(theirs)?, network(ours)?);
    // Coordinates that are absolute values show no sign.
    let same_sign = theirs.network.sign_seen() == ours.network.sign_seen();
    let mut differences: Vec<String> = our_network
        .iter()
        .filter(|(key, _)| *key != SIGN || !same_sign)
        .filter_map(|(key, ours)| {
            let theirs = their_network.get(key)?;
            let hint = if key == SIGN { SIGN_HINT } else { "" };
            (theirs != ours).then(|| format!("network.{key} is {ours}, there {theirs}{hint}"))
        })
        .collect();
    if theirs.episode.action_space != ours.episode.action_space {
        differences.push(format!(
            "episode.action_space has {} actions, there {}",
            ours.action_head().outputs(),
            theirs.action_head().outputs()
        ));
    }
    if theirs.episode.action_space == ours.episode.action_space && shape_of(theirs) != shape_of(ours) {
        differences.push(format!("task is {}, there {}, of other observations or actions", ours.task, theirs.task));
    }
    if theirs.normalize.observations != ours.normalize.observations {
        let [ours, theirs] = [ours, theirs].map(|config| config.normalize.observations);
        differences.push(format!("normalize.observations is {ours}, there {theirs}"));
    }
    if theirs.auxiliary.task != ours.auxiliary.task {
        differences.push(format!(
            "auxiliary.task is {}, there {}",
            json!(ours.auxiliary.task),
            json!(theirs.auxiliary.task)
        ));
    }
    Ok(differences)
}

/// What a task gives a network, and asks of it.
fn shape_of(config: &Config) -> impl PartialEq + use<> {
    let inputs = config.spec().inputs().ok();
    let shapes = inputs.map(|inputs| {
        let images: Vec<[usize; 3]> = inputs.images.iter().map(Image::shape).collect();
        (inputs.frame.is_some(), images, inputs.policy_width(), inputs.width())
    });
    (config.action_head().outputs(), config.action_head().is_gaussian(), shapes)
}

pub fn find(named: &Path) -> Result<Source> {
    let whole = absolute(named)?;
    let path = RunFolder::through_best(whole.clone());
    // A message names what was typed.
    let path = if path == whole { named.to_path_buf() } else { path };
    if !path.exists() {
        let run = path.parent().map(RunFolder::new).filter(|_| path.ends_with("best"));
        demand!(
            run.is_none_or(|run| !run.identity().exists()),
            "{} does not exist: the run has no validation, which would choose it (`--set validation.every_frames=N`); \
             the run's folder means its newest checkpoint",
            path.display()
        );
        if let Some(preset) = presets().iter().find(|preset| named.as_os_str() == &*preset.name) {
            let preset = &preset.name;
            reject!(
                "{preset} is a preset, without weights: `orchestrator eval --preset {preset}` evaluates untrained ones"
            );
        }
        reject!("{} does not exist{}", path.display(), perhaps(named));
    }
    let is_tensors = path.extension().is_some_and(|kind| kind == "safetensors");
    if is_tensors && !path.is_dir() && !path.with_extension("json").is_file() {
        let policy = Box::new(export::open(&path).map_err(no_policy)?);
        return Ok(Source::File { path: absolute(&path)?, policy });
    }
    find_checkpoint(&path).map(|found| Source::Checkpoint(Box::new(found)))
}

fn absolute(path: &Path) -> Result<PathBuf> {
    std::path::absolute(path).with_context(|| path.display().to_string())
}

fn find_checkpoint(path: &Path) -> Result<Found> {
    demand!(
        path.extension().is_none_or(|kind| kind != "onnx"),
        "{} is ONNX, a model for other programs, without its run's configuration: give the run, or a policy file \
         (`orchestrator export RUN --out policy.safetensors`)",
        path.display()
    );
    let manifest = if path.is_dir() {
        let folder = RunFolder::new(path);
        let checkpoints = folder.checkpoints();
        let place = if checkpoints.is_dir() { &checkpoints } else { folder.root() };
        let found = newest_whole(&folder, place);
        if let (Err(error), false) = (&found, checkpoints.is_dir()) {
            let asked = Config::of_run(&folder).ok().and_then(|config| config.evaluation);
            let of = asked.map(|asked| asked.checkpoint.map_or_else(String::new, |policy| format!(" of {policy}")));
            demand!(of.is_none(), "{} is an evaluation{}: {GIVE}", path.display(), of.unwrap_or_default());
            reject!("{error:#}: {}", advice(path));
        }
        let (manifest, damaged) = found.map_err(|error| anyhow!("{error:#}{}", remedy(&folder)))?;
        for error in damaged {
            tracing::warn!("{error:#}: {} is taken", manifest.display());
        }
        manifest
    } else {
        path.with_extension("json")
    };
    let manifest = absolute(&manifest)?;
    let named =
        RunFolder::new(if path.is_dir() { absolute(path)? } else { manifest.parent().unwrap_or(&manifest).to_owned() });
    demand!(
        RolloutName::Manifest.rollout_of(&manifest).is_some() && named.has(&manifest),
        "{} is no checkpoint (those are called rollout-00000012.json) and no policy file (.safetensors): give the run, \
         or a file of one of these",
        path.display()
    );
    let mut folders = manifest.ancestors().skip(1).take(3);
    let Some(run) = folders.find(|folder| folder.join("config.toml").is_file()) else {
        bail!(
            "the configuration of {} is missing: there is no config.toml beside it or in the two folders above",
            manifest.display()
        );
    };
    let config = Config::of_run(&RunFolder::new(run))?;
    Ok(Found { run: run.to_path_buf(), named, manifest, config })
}

/// A file that only by its name holds weights.
fn no_policy(error: PolicyError) -> anyhow::Error {
    match error {
        PolicyError::Tensors { path, .. } => wrong(anyhow!(
            "{} is no safetensors file: give the folder of a run, one of its checkpoints, or a policy file \
             (`orchestrator export RUN --out policy.safetensors`)",
            path.display()
        )),
        other => other.into(),
    }
}

/// What to do with a run that has no checkpoint.
fn remedy(run: &RunFolder) -> String {
    if !run.identity().exists() {
        return String::new();
    }
    if std::fs::metadata(run.metrics()).is_ok_and(|metrics| metrics.len() > 0) {
        return ": the run has trained, so put that folder back from a copy".to_owned();
    }
    format!(": `orchestrator resume {}` trains the run, and saves one first", quoted(run.root()))
}

const GIVE: &str = "give the folder of a run, one of its checkpoints, or a policy file (.safetensors)";

/// What to name instead of a folder that is no run.
fn advice(folder: &Path) -> String {
    let files = RunFolder::new(folder).list(folder).unwrap_or_default().into_iter().map(|item| item.path);
    let policy = files.filter(|path| path.extension().is_some_and(|kind| kind == "safetensors")).min();
    let policy = policy.map(|path| format!("name the policy file {}", path.display()));
    policy.unwrap_or_else(|| GIVE.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::checkpoints::tests::manifest;
    use proto::config::{CarriedGoal, GoalCoordinates};

    #[test]
    fn weights_of_the_other_sign_are_those_of_another_network() {
        let mut theirs = Config::resolve("paper", None).unwrap();
        let ours = theirs.clone();
        assert_eq!(network_differences(&theirs, &ours).unwrap(), Vec::<String>::new());
        theirs.network.carried_goal = CarriedGoal::ObjectToGoal;
        let differences = network_differences(&theirs, &ours).unwrap();
        let expected = "network.carried_goal is \"goal_to_object\", there \"object_to_goal\" (while the target is held";
        assert!(differences.len() == 1 && differences[0].starts_with(expected), "{differences:?}");

        let of = |preset| Config::resolve(preset, None).unwrap();
        let differences = network_differences(&of("point-nav-demo"), &of("demo")).unwrap();
        assert_eq!(differences, ["task is arm_point_nav, there point_nav, of other observations or actions"]);
        // Absolute values are the same with both.
        let cartesian = |mut config: Config| {
            config.network.goal = GoalCoordinates::Cartesian;
            config
        };
        let none = network_differences(&cartesian(theirs), &cartesian(ours)).unwrap();
        assert_eq!(none, Vec::<String>::new());
    }

    #[test]
    fn a_path_means_a_checkpoint() {
        let temporary = tempfile::tempdir().unwrap();
        let run = temporary.path().join("run");
        let checkpoints = run.join("checkpoints");
        std::fs::create_dir_all(&checkpoints).unwrap();
        assert!(find(&run).unwrap_err().to_string().contains("no checkpoint in"));
        assert!(find("demo".as_ref()).unwrap_err().to_string().contains("`orchestrator eval --preset demo` evaluates"));
        for rollout in [3, 12] {
            std::fs::write(checkpoints.join(format!("rollout-{rollout:08}.json")), manifest(rollout, 0)).unwrap();
            let tensors = checkpoints.join(format!("rollout-{rollout:08}.safetensors"));
            std::fs::write(tensors, format!("tensors {rollout}")).unwrap();
        }
        assert!(find(&run).unwrap_err().to_string().contains("config.toml"));
        let config = Config::resolve("demo", None).unwrap();
        std::fs::write(run.join("config.toml"), config.to_toml()).unwrap();
        let find = |path: &Path| super::find(path).and_then(Source::checkpoint);
        let found = find(&run).unwrap();
        assert_eq!(found.manifest, checkpoints.join("rollout-00000012.json"));
        assert_eq!((found.run.as_path(), found.config), (run.as_path(), config));
        for name in ["rollout-00000003.json", "rollout-00000003.safetensors"] {
            assert_eq!(find(&checkpoints.join(name)).unwrap().manifest, checkpoints.join("rollout-00000003.json"));
        }
        // A damaged one is passed over, and taken where it is asked for: whoever reads it names it.
        std::fs::write(checkpoints.join("rollout-00000012.safetensors"), "tensors").unwrap();
        assert_eq!(find(&run).unwrap().manifest, checkpoints.join("rollout-00000003.json"));
        std::fs::remove_file(checkpoints.join("rollout-00000012.safetensors")).unwrap();
        std::os::unix::fs::symlink("/dev/zero", checkpoints.join("rollout-00000012.safetensors")).unwrap();
        assert_eq!(find(&run).unwrap().manifest, checkpoints.join("rollout-00000003.json"), "a device is not read");
        std::fs::remove_file(checkpoints.join("rollout-00000012.safetensors")).unwrap();
        std::fs::write(checkpoints.join("rollout-00000012.safetensors"), "tensors").unwrap();
        let asked = checkpoints.join("rollout-00000012.json");
        assert_eq!(find(&asked).unwrap().manifest, asked);
        std::fs::remove_file(checkpoints.join("rollout-00000003.safetensors")).unwrap();
        let none = format!("{:#}", find(&run).unwrap_err());
        assert!(none.contains("is whole: ") && none.contains("rollout-00000012.safetensors is damaged"), "{none}");
        assert!(find(&run.join("config.toml")).unwrap_err().to_string().contains("is no checkpoint"));
        assert!(find(&run.join("nothing")).unwrap_err().to_string().contains("does not exist"));
        // Tensors without a manifest beside them are a policy file, or nothing.
        let alone = run.join("policy.safetensors");
        std::fs::write(&alone, "nothing").unwrap();
        assert!(find(&alone).unwrap_err().to_string().contains("policy.safetensors is no safetensors file"));
    }
}
