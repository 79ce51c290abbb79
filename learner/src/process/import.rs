//! `learner import`: a run's first checkpoint from weights of elsewhere. Started by `orchestrator import`, which has
//! made the run folder.

use super::lock::{self, Lock};
use super::machine;
use super::weights::facts_of;
use crate::agent::{Agent, OtherSign};
use crate::checkpoint::{Snapshot, Store, decode_tensors};
use crate::collector::{Boundary, ColumnMap};
use crate::import::{Names, Naming, how_to_convert};
use crate::{device, import};
use anyhow::{Context, Result, anyhow, bail, ensure};
use proto::checkpoint::Manifest;
use proto::config::{CarriedGoal, Config, NetworkConfig};
use proto::digest::sha256;
use proto::policy_file::BYTES_MOST;
use proto::run_folder::RunFolder;
use proto::trained::History;
use std::io::Write;
use std::path::{Path, PathBuf};

/// What `learner import` is asked.
#[derive(Debug, Clone, clap::Args)]
pub struct ImportArguments {
    /// A state dict: AllenAct's, a checkpoint of a run, or weights by our names
    #[arg(long, value_name = "S.safetensors")]
    from: PathBuf,
    /// Run folder; its config.toml names the network
    #[arg(long, value_name = "RUN")]
    run: PathBuf,
    /// Id that the run is to have
    #[arg(long, value_name = "ID", default_value = "")]
    run_id: String,
}

/// Writes the run's first checkpoint, and prints the destination of every weight.
pub fn import(arguments: &ImportArguments, mut output: impl Write) -> Result<()> {
    let ImportArguments { from, run, run_id } = arguments;
    let run = RunFolder::new(run);
    let config = Config::of_run(&run)?;
    let bytes = proto::bounded::read(from, BYTES_MOST).with_context(|| format!("cannot read {}", from.display()))?;
    ensure!(!bytes.is_empty(), "{}: the file is empty", from.display());
    let state_dict = decode_tensors(&bytes)
        // The text alone: it has that of its source in it.
        .map_err(|cause| anyhow!(how_to_convert(from, &bytes).unwrap_or_else(|| cause.to_string())))
        .with_context(|| from.display().to_string())?;
    let _lock = Lock::take(&run.learner_lock(0), lock::PATIENCE, || false)?;
    let device = device::choose(&config.learner)?;
    let machine = machine::machine(device, config.learner);
    let store = Store::new((run.clone(), run_id), &config.stages, &config.to_toml(), machine, config.checkpoint.keep)
        .of_unmade();
    if let Some(loaded) = store.load()? {
        bail!("{} has begun: it holds {}", run.root().display(), loaded.path);
    }
    let mut agent = Agent::new(&config, device)?;
    let mut state = agent.state();
    let naming = Names::of(&state_dict, &state).naming;
    let mut judge = || {
        let told = told_by(naming, from, &bytes)?;
        // Another network's names and shapes are others, and this says why.
        told.iter().try_for_each(|told| told.refuse_other_network(&config))?;
        let imported = import::import(&state_dict, &mut state)?;
        told.iter().try_for_each(|told| OtherSign::refuse(told.sign, &config.network))?;
        anyhow::Ok((told, imported))
    };
    let (told, imported) = judge().with_context(|| from.display().to_string())?;
    agent.load_state(&state)?;
    let snapshot = Snapshot {
        rollout: 0,
        frames: 0,
        agent: agent.state(),
        boundary: Boundary::start(ColumnMap::of(0, &config).columns()),
        weights: agent.weights_digest(),
    };
    let checkpoint = store.save(&snapshot, &History::default(), false)?;

    writeln!(output, "{} weights of {}", imported.taken, from.display())?;
    for prefix in &imported.taken_off {
        writeln!(output, "the names are read without `{prefix}`")?;
    }
    for (names, what) in [(&imported.fresh, "starts from the seed"), (&imported.left_out, "is left out")] {
        for name in names {
            writeln!(output, "{name} {what}")?;
        }
    }
    writeln!(output, "{}", assumed_goal(&config.network, told.as_ref()))?;
    writeln!(output, "checkpoint: {checkpoint}")?;
    writeln!(output, "weights: {}", snapshot.weights)?;
    Ok(())
}

/// What is known of the network that a file's weights are of. Shapes do not show all of it.
#[derive(Debug)]
struct Told {
    sign: CarriedGoal,
    /// The whole configuration, where the file names it.
    config: Option<Box<Config>>,
    whose: &'static str,
}

impl Told {
    fn refuse_other_network(&self, config: &Config) -> Result<()> {
        if let Some(theirs) = &self.config {
            let mut trained = config.clone();
            // The sign has an error of its own, which applies only where the network sees a sign.
            // What weights began with does not matter.
            let NetworkConfig { carried_goal, initial, log_std, .. } = config.network;
            trained.network = NetworkConfig { carried_goal, initial, log_std, ..theirs.network.clone() };
            trained.episode.action_space = theirs.episode.action_space;
            let changes = config.changes_since(&trained);
            ensure!(
                changes.is_empty(),
                "the configuration's network is not the one that these weights were trained in: {}",
                changes.join("; ")
            );
        }
        Ok(())
    }
}

/// What tells of a file's weights: AllenAct's sensor, a checkpoint's manifest, a policy file's metadata. None where
/// nothing does. A file that is not the one that its manifest or its metadata name is damaged.
fn told_by(naming: Naming, from: &Path, bytes: &[u8]) -> Result<Option<Told>> {
    match naming {
        // Its sensor is object − goal.
        Naming::AllenAct => Ok(Some(Told { sign: CarriedGoal::GoalToObject, config: None, whose: "AllenAct's" })),
        Naming::Checkpoint => {
            let path = from.with_extension("json");
            if !path.exists() {
                return Ok(None);
            }
            let manifest = Manifest::read(&path).map_err(|cause| anyhow!("{} {cause}", path.display()))?;
            ensure!(
                sha256(bytes) == manifest.tensors_sha256,
                "the checkpoint is damaged: its SHA-256 is not the one that {} names",
                path.display()
            );
            // An older version wrote none.
            let config = (!manifest.config.is_empty())
                .then(|| Config::from_toml(&manifest.config, &path.display().to_string()).map(Box::new))
                .transpose()?;
            Ok(Some(Told { sign: manifest.carried_goal, config, whose: "the checkpoint's" }))
        }
        Naming::Ours => Ok(facts_of(bytes)?.map(|facts| Told {
            sign: facts.origin.carried_goal,
            config: Some(Box::new(facts.config)),
            whose: "the policy file's",
        })),
    }
}

/// Which goal the weights are taken to have been trained on: their shapes are the same for all.
fn assumed_goal(network: &NetworkConfig, told: Option<&Told>) -> String {
    let assumed = "weights do not tell";
    let goal = told.filter(|told| told.config.is_some()).map_or(assumed, |told| told.whose);
    match network.sign_seen() {
        None => format!("the goal is taken to be cartesian (network.goal; {goal})"),
        Some(carried) => format!(
            "the goal is taken to be polar (network.goal; {goal}), {carried} while the target is held \
             (network.carried_goal; {})",
            told.map_or(assumed, |told| told.whose)
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::agent::MODEL;
    use proto::config::GoalCoordinates;
    use proto::policy_file::{ENTRY, tensors_sha256};
    use safetensors::{Dtype, tensor::TensorView};
    use std::collections::BTreeMap;

    fn small() -> Config {
        let mut config = Config::resolve("demo", None).unwrap();
        config.network.hidden = 16;
        config
    }

    /// Weights by our names that a run with this configuration could have, with a policy file's metadata or without.
    fn write_weights(path: &Path, config: &Config, as_policy: bool) {
        let state = Agent::new(config, tch::Device::Cpu).unwrap().state();
        let weights: BTreeMap<&str, (Vec<usize>, Vec<u8>)> = state
            .tensors
            .iter()
            .filter_map(|(name, tensor)| Some((name.strip_prefix(MODEL)?, tensor)))
            .map(|(name, tensor)| {
                let values: Vec<f32> = tensor.flatten(0, -1).try_into().unwrap();
                let shape = tensor.size().iter().map(|&side| side as usize).collect();
                (name, (shape, values.iter().flat_map(|value| value.to_le_bytes()).collect()))
            })
            .collect();
        let views: Vec<(&str, TensorView)> = weights
            .iter()
            .map(|(name, (shape, bytes))| (*name, TensorView::new(Dtype::F32, shape.clone(), bytes).unwrap()))
            .collect();
        let digest = tensors_sha256(weights.iter().map(|(name, (_, bytes))| (*name, bytes.as_slice())));
        let facts = serde_json::json!({
            "config": config.to_toml(), "run": "0123", "rollout": "1", "frames": "24", "weights_sha256": "",
            "tensors_sha256": digest,
        });
        let metadata = as_policy.then(|| [(ENTRY.to_owned(), facts.to_string())].into());
        safetensors::serialize_to_file(views, metadata, path).unwrap();
    }

    /// What an import into a new run of this configuration prints, or why it is refused.
    fn import_into(config: &Config, from: &Path) -> Result<String, String> {
        let folder = tempfile::tempdir().unwrap();
        let run = RunFolder::new(folder.path());
        std::fs::write(run.config(), config.to_toml()).unwrap();
        let arguments = ImportArguments { from: from.to_owned(), run: folder.path().to_owned(), run_id: String::new() };
        let mut printed = Vec::new();
        let imported = import(&arguments, &mut printed);
        assert_eq!(imported.is_ok(), run.checkpoint_manifest(0).exists());
        imported.map_err(|error| format!("{error:#}"))?;
        Ok(String::from_utf8(printed).unwrap())
    }

    #[test]
    fn a_policy_file_under_another_sign_or_another_goal_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let (policy, weights) = (folder.path().join("policy.safetensors"), folder.path().join("weights.safetensors"));
        write_weights(&policy, &small(), true);
        write_weights(&weights, &small(), false);
        let said = import_into(&small(), &policy).unwrap();
        assert!(said.contains("polar (network.goal; the policy file's), object_to_goal while"), "{said}");
        assert!(said.contains("(network.carried_goal; the policy file's)"), "{said}");

        let mut other = small();
        other.network.carried_goal = CarriedGoal::GoalToObject;
        let refused = import_into(&other, &policy).unwrap_err();
        assert!(refused.starts_with(&policy.display().to_string()), "{refused}");
        assert!(refused.contains("trained with network.carried_goal = \"object_to_goal\""), "{refused}");
        // Weights alone tell nothing: they are taken for the configuration's.
        let said = import_into(&other, &weights).unwrap();
        assert!(said.contains("goal_to_object while the target is held (network.carried_goal; weights do"), "{said}");

        // With absolute values no sign is seen, but these weights have not been trained on them.
        other.network.goal = GoalCoordinates::Cartesian;
        let refused = import_into(&other, &policy).unwrap_err();
        assert!(refused.ends_with("trained in: network.goal = \"cartesian\" instead of \"polar\""), "{refused}");
        write_weights(&policy, &other, true);
        other.network.carried_goal = CarriedGoal::ObjectToGoal;
        assert!(import_into(&other, &policy).is_ok(), "the sign is not seen");
    }

    /// A file of one tensor, and of none.
    #[test]
    fn what_is_no_file_of_weights_is_not_blamed_for_the_sign_of_its_goal() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("w.safetensors");
        let refused = |bytes: &[u8]| {
            std::fs::write(&file, bytes).unwrap();
            import_into(&small(), &file).unwrap_err()
        };
        assert_eq!(small().network.carried_goal, CarriedGoal::ObjectToGoal, "which is not AllenAct's");
        assert!(refused(b"").ends_with("the file is empty"));
        let none: Vec<(&str, TensorView)> = Vec::new();
        assert!(refused(&safetensors::serialize(none, None).unwrap()).ends_with("the file holds no weights"));
        let values = [0; 4];
        let one = |name| vec![(name, TensorView::new(Dtype::F32, vec![1], &values).unwrap())];
        let alien = refused(&safetensors::serialize(one("epoch"), None).unwrap());
        assert!(alien.contains("`epoch` is no weight of a network of ours"), "{alien}");
        let lacking = refused(&safetensors::serialize(one("module.critic.fc.bias"), None).unwrap());
        assert!(lacking.contains("nothing is there for `actor.bias`"), "{lacking}");
        assert!(lacking.ends_with("the file has no `module.actor.linear.bias`"), "{lacking}");
    }

    #[test]
    fn a_damaged_policy_file_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let policy = folder.path().join("policy.safetensors");
        write_weights(&policy, &small(), true);
        let mut bytes = std::fs::read(&policy).unwrap();
        // The lowest bit of a weight: it stays a finite number.
        let at = bytes.len() - 4;
        bytes[at] ^= 1;
        std::fs::write(&policy, bytes).unwrap();
        let refused = import_into(&small(), &policy).unwrap_err();
        let expected = "the policy file is damaged: the SHA-256 of its weights is not the one that its metadata name";
        assert_eq!(refused, format!("{}: {expected}", policy.display()));

        let whole = std::fs::read(&policy).unwrap();
        std::fs::write(&policy, &whole[..100]).unwrap();
        let refused = import_into(&small(), &policy).unwrap_err();
        assert_eq!(refused.matches("invalid header length").count(), 1, "{refused}");
    }
}
