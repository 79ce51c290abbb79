//! `orchestrator import`: a run that begins with weights of elsewhere. (Those of a run of ours: `up --from`.)

use super::overrides::Overrides;
use crate::output::log_line::error_in;
use crate::output::terminal;
use crate::preflight::programs::Tools;
use crate::run::create::{check_free, prepare};
use crate::run::identity::Identity;
use crate::run::scenes;
use crate::wrong::{demand, reject};
use anyhow::{Context, Result, anyhow, bail, ensure};
use export::PolicyError;
use proto::config::{Config, presets};
use proto::exit::how;
use proto::plain_file::open_plain;
use proto::policy_file::PolicyFileError;
use proto::run_folder::{RunFolder, unlike_a_flag};
use proto::shell::quoted;
use std::fs::OpenOptions;
use std::io::Read;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The preset whose network weights are taken for that name none, unless the user names one.
const DEFAULT_PRESET: &str = "paper";

/// Make a run that begins with the weights in a file: an AllenAct state dict, or weights by our own names
///
/// The run folder is made as by `up`, at 0 frames: `orchestrator resume RUN` trains on from there, `eval RUN` evaluates
/// it. AllenAct's names are translated (docs/probe.md has the table), and a prefix of all names is taken off, such as
/// `DataParallel`'s `module.`; weights of an auxiliary task that the configuration does not train are left out, and those
/// of one that the file lacks start from the seed. A policy file and a checkpoint name their network and the sign of their
/// goal: the configuration must have the same.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  python3 -c \"import torch, safetensors.torch as s; w = torch.load('exp.pt', map_location='cpu'); \
s.save_file({k: v.clone().contiguous() for k, v in w.get('model_state_dict', w.get('state_dict', w)).items()}, \
'exp.safetensors')\"
  orchestrator import exp.safetensors --preset disturb-stage2-25m \\
    --run runs/theirs
  orchestrator resume runs/theirs

Weights of another run of ours need no import: `orchestrator up --from RUN`.")]
pub struct ImportArgs {
    /// The weights (.safetensors)
    #[arg(value_name = "FILE")]
    from: PathBuf,
    /// Named configuration (`orchestrator presets`): its network must be the weights' [default: that of a
    /// policy file, else paper]
    #[arg(long, value_name = "P")]
    preset: Option<String>,
    #[command(flatten)]
    overrides: Overrides,
    /// Run folder, new or empty
    #[arg(long, value_name = "DIR")]
    run: PathBuf,
}

pub fn run(args: &ImportArgs) -> Result<()> {
    let folder = RunFolder::new(&args.run);
    demand!(args.from.exists(), "{} does not exist", args.from.display());
    demand!(
        !args.from.is_dir(),
        "{} is a folder: give a file of weights; `orchestrator up --from RUN` begins with a run's",
        args.from.display()
    );
    check_free(&folder)?;
    let named = named_preset(&args.from)?;
    let mut defaulted = false;
    let default = || {
        defaulted = named.is_none();
        Ok(named.as_deref().unwrap_or(DEFAULT_PRESET))
    };
    let mut config = args.overrides.resolve(&args.overrides.preset(args.preset.as_deref(), default)?)?;
    let tools = Tools::find()?;
    scenes::check(&config)?;
    let was_there = folder.root().exists();
    let lock = prepare(&folder, &mut config, &[folder.checkpoints(), folder.recordings()])?;
    // run.toml comes last: a folder without it is no run, whatever happens here.
    let identity = Identity::new()?;
    let imported = take_weights(&args.from, &folder, &identity.id, &tools).and_then(|()| identity.write(&folder));
    drop(lock);
    if imported.is_err() {
        let root = folder.root();
        remove(root, was_there).with_context(|| format!("cannot remove {}", root.display()))?;
    }
    imported.map_err(|error| if defaulted { anyhow!("{error:#}. {}", other_presets(&config)) } else { error })?;
    terminal::note(&format!("`orchestrator resume {}` trains on from these weights", quoted(folder.root())));
    Ok(())
}

/// The preset that a policy file names; none for other weights, which the learner judges. A damaged one is refused.
fn named_preset(from: &Path) -> Result<Option<String>> {
    match export::open(from) {
        Ok(policy) => Ok(Some(policy.config.preset)),
        Err(error @ PolicyError::NoPolicy { problem: PolicyFileError::Damaged, .. }) => Err(error.into()),
        Err(PolicyError::Tensors { .. }) if is_of_no_program(from) => {
            let is_onnx = from.extension().is_some_and(|kind| kind == "onnx");
            reject!(
                "{} is {}: weights are a policy file, a checkpoint's tensors, or a state dict saved as .safetensors",
                from.display(),
                if is_onnx { "ONNX" } else { "no safetensors file" }
            )
        }
        Err(_) => Ok(None),
    }
}

/// Whether a file is neither empty nor of `torch.save`, a zip archive or a pickle: of these the learner tells more.
fn is_of_no_program(path: &Path) -> bool {
    let mut first = [0; 2];
    let read = open_plain(path, OpenOptions::new().read(true)).and_then(|mut file| file.read_exact(&mut first));
    read.is_ok() && &first != b"PK" && first[0] != 0x80
}

/// Removes a folder that was made, or was empty before, so that all in it is ours. One that was there is the user's own
/// and stays.
fn remove(root: &Path, was_there: bool) -> std::io::Result<()> {
    if !was_there {
        return std::fs::remove_dir_all(root);
    }
    for entry in std::fs::read_dir(root)? {
        let entry = entry?;
        if entry.file_type()?.is_dir() {
            std::fs::remove_dir_all(entry.path())?;
        } else {
            std::fs::remove_file(entry.path())?;
        }
    }
    Ok(())
}

/// What else the weights could be for: of each other network the first preset that has it.
fn other_presets(taken: &Config) -> String {
    let network = |config: &Config| (config.network.clone(), config.episode.action_space);
    let mut known = vec![network(taken)];
    let mut names = Vec::new();
    for preset in presets() {
        let Ok(config) = Config::resolve(&preset.name, None) else { continue };
        if !known.contains(&network(&config)) {
            known.push(network(&config));
            names.push(preset.name.as_str());
        }
    }
    format!(
        "The network was that of the preset {}, because --preset names none; others have another network: {}, and those \
         that `orchestrator presets` lists beside them",
        taken.preset,
        names.join(", ")
    )
}

fn take_weights(from: &Path, folder: &RunFolder, id: &str, tools: &Tools) -> Result<()> {
    let learner = &tools.programs.learner;
    let output = Command::new(learner)
        .envs(tools.programs.learner_environment.iter().map(|(name, value)| (name, value)))
        .arg("import")
        .args([Path::new("--from"), &unlike_a_flag(from), Path::new("--run"), folder.root()])
        .args(["--run-id", id])
        .output()
        .with_context(|| format!("cannot start {}", learner.display()))?;
    if !output.status.success() {
        ensure!(output.status.signal().is_none(), "`learner import` {}", how(output.status));
        let complaint = String::from_utf8_lossy(&output.stderr);
        bail!("{}", error_in(&complaint).unwrap_or(&complaint).trim_end());
    }
    for line in String::from_utf8_lossy(&output.stdout).lines() {
        terminal::out(line);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_policy_file_names_its_preset_and_a_damaged_one_is_refused() {
        let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("../models/fetch.safetensors");
        let named = named_preset(&models).unwrap().expect("a policy file names one");
        let network = export::open(&models).unwrap().config.network;
        assert_eq!(Config::resolve(&named, None).unwrap().network, network);
        assert_ne!(Config::resolve(DEFAULT_PRESET, None).unwrap().network, network);
        let temporary = tempfile::tempdir().unwrap();
        let other = temporary.path().join("other.safetensors");
        let mut bytes = std::fs::read(models).unwrap();
        *bytes.last_mut().unwrap() ^= 1;
        std::fs::write(&other, bytes).unwrap();
        let refused = named_preset(&other).unwrap_err().to_string();
        assert!(refused.starts_with(&format!("{} is damaged", other.display())), "{refused}");
        std::fs::write(&other, "weights of somebody else's").unwrap();
        let refused = named_preset(&other).unwrap_err().to_string();
        assert!(refused.contains("is no safetensors file"), "{refused}");
        std::fs::write(&other, b"\x02\0\0\0\0\0\0\0{}").unwrap();
        assert_eq!(named_preset(&other).unwrap(), None, "weights of somebody else's");
    }

    #[test]
    fn a_folder_of_the_users_own_stays_when_an_import_fails() {
        let temporary = tempfile::tempdir().unwrap();
        for was_there in [true, false] {
            let root = temporary.path().join("run");
            std::fs::create_dir_all(root.join("logs")).unwrap();
            std::fs::write(root.join("config.toml"), "seed = 1").unwrap();
            std::fs::write(root.join("logs/learner.log"), "").unwrap();
            remove(&root, was_there).unwrap();
            assert_eq!(root.exists(), was_there);
            assert!(!was_there || std::fs::read_dir(&root).unwrap().next().is_none());
        }
    }

    #[test]
    fn of_each_other_network_one_preset_is_named() {
        let taken = Config::resolve(DEFAULT_PRESET, None).unwrap();
        let text = other_presets(&taken);
        let list = text.split("another network: ").nth(1).unwrap().split(", and those").next().unwrap();
        let others: Vec<Config> = list.split(", ").map(|name| Config::resolve(name, None).unwrap()).collect();
        let network = |config: &Config| (config.network.clone(), config.episode.action_space);
        for (index, one) in others.iter().enumerate() {
            assert!(others[..index].iter().chain([&taken]).all(|other| network(other) != network(one)), "{text}");
        }
        for preset in presets() {
            let config = Config::resolve(&preset.name, None).unwrap();
            assert!(others.iter().chain([&taken]).any(|one| network(one) == network(&config)), "{}", preset.name);
        }
    }
}
