//! A policy as a file of its own: the metadata of the safetensors file that `orchestrator export --format safetensors`
//! writes. With them the file alone is enough to build the network, to let it act, and to tell where it comes from.
//!
//! The metadata have one entry, `stillroom`: a JSON object of strings. This module reads those of them that a program of
//! ours needs; the others (names of actions, units) are for other programs.

use crate::config::{AuxiliaryTask, CarriedGoal, Config, ConfigError};
use crate::digest::hex;
use crate::task::{Spec, SpecError};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;

pub const ENTRY: &str = "stillroom";
/// A larger file is not read as a policy.
pub const BYTES_MOST: u64 = 1 << 30;

#[derive(Debug, thiserror::Error)]
pub enum PolicyFileError {
    #[error(
        "does not say of which network its weights are: `orchestrator export RUN --format safetensors` writes files that \
         do; other weights become a run with `orchestrator import`"
    )]
    Nameless,
    #[error("has metadata that cannot be read: {0}")]
    Metadata(#[from] serde_json::Error),
    #[error("says nothing of `{0}` in its metadata: export it again with this version")]
    Lacks(&'static str),
    #[error("holds a configuration that cannot be used: {0}")]
    Config(#[from] ConfigError),
    #[error("holds a task that cannot be used: {0}")]
    Task(#[from] SpecError),
    #[error("is damaged: the SHA-256 of its weights is not the one that its metadata name")]
    Damaged,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Origin {
    pub run: String,
    /// First rollout that it was not trained on.
    pub rollout: u64,
    pub frames: u64,
    /// Digest of the weights in the run's checkpoint, which had 32 bits each.
    pub weights: String,
    /// Sign of the goal vector that it was trained with.
    pub carried_goal: CarriedGoal,
}

#[derive(Debug, Clone, PartialEq)]
pub struct PolicyFacts {
    /// The run's configuration, as [`configuration_alone`] leaves it.
    pub config: Config,
    pub origin: Origin,
    tensors_sha256: String,
}

impl PolicyFacts {
    /// Reads the metadata of a file; `origin` names the file in errors of the configuration.
    pub fn read(metadata: Option<&BTreeMap<String, String>>, origin: &str) -> Result<Self, PolicyFileError> {
        let text = metadata.and_then(|metadata| metadata.get(ENTRY)).ok_or(PolicyFileError::Nameless)?;
        let facts: BTreeMap<String, String> = serde_json::from_str(text)?;
        let fact = |name: &'static str| facts.get(name).ok_or(PolicyFileError::Lacks(name));
        let number = |name| fact(name)?.parse().map_err(|_| PolicyFileError::Lacks(name));
        // A task that is not built in.
        if let Some(declaration) = facts.get("task") {
            Spec::declare(declaration)?;
        }
        let config = configuration_alone(Config::from_toml(fact("config")?, origin)?);
        let origin = Origin {
            run: fact("run")?.clone(),
            rollout: number("rollout")?,
            frames: number("frames")?,
            weights: fact("weights_sha256")?.clone(),
            carried_goal: config.network.carried_goal,
        };
        Ok(Self { config, origin, tensors_sha256: fact("tensors_sha256")?.clone() })
    }

    /// Compares the file's tensors with what was written: names, ascending, and bytes.
    pub fn verify<'a>(&self, tensors: impl Iterator<Item = (&'a str, &'a [u8])>) -> Result<(), PolicyFileError> {
        if tensors_sha256(tensors) == self.tensors_sha256 { Ok(()) } else { Err(PolicyFileError::Damaged) }
    }
}

/// A run's configuration without what lies elsewhere on the machine of the run or does not act: its scenes, the weights
/// that it began with, an evaluation's table, the auxiliary task.
pub fn configuration_alone(mut config: Config) -> Config {
    config.scenes.clear();
    config.from = None;
    config.evaluation = None;
    config.auxiliary.task = AuxiliaryTask::None;
    config
}

/// SHA-256 over names, which must ascend, and bytes of tensors.
pub fn tensors_sha256<'a>(tensors: impl Iterator<Item = (&'a str, &'a [u8])>) -> String {
    let mut digest = Sha256::new();
    for (name, bytes) in tensors {
        digest.update(name.as_bytes());
        digest.update((bytes.len() as u64).to_le_bytes());
        digest.update(bytes);
    }
    hex(digest.finalize())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn facts() -> BTreeMap<String, String> {
        let mut config = Config::resolve("demo", None).unwrap();
        config.network.hidden = 64;
        let facts = [
            ("config", config.to_toml()),
            ("run", "0123".to_owned()),
            ("rollout", "12".to_owned()),
            ("frames", "4000".to_owned()),
            ("weights_sha256", "abcd".to_owned()),
            ("tensors_sha256", tensors_sha256([("a", &b"12"[..])].into_iter())),
        ];
        facts.map(|(name, value)| (name.to_owned(), value)).into()
    }

    fn read(facts: &BTreeMap<String, String>) -> Result<PolicyFacts, PolicyFileError> {
        let metadata = [(ENTRY.to_owned(), serde_json::to_string(facts).unwrap())].into();
        PolicyFacts::read(Some(&metadata), "a file")
    }

    #[test]
    fn the_metadata_are_enough_to_build_the_network() {
        let read = read(&facts()).unwrap();
        assert_eq!((read.config.network.hidden, read.config.auxiliary.task), (64, AuxiliaryTask::None));
        assert_eq!((read.origin.frames, read.origin.rollout), (4000, 12));
        assert_eq!(read.origin.carried_goal, CarriedGoal::ObjectToGoal);
        assert!(read.verify([("a", &b"12"[..])].into_iter()).is_ok());
        for other in [("a", &b"13"[..]), ("b", &b"12"[..])] {
            let damaged = read.verify([other].into_iter()).unwrap_err();
            assert!(damaged.to_string().contains("is damaged"), "{damaged}");
        }
    }

    #[test]
    fn what_lies_on_the_machine_of_the_run_is_left_out() {
        let mut config = Config::resolve("paper", None).unwrap();
        config.scenes = vec!["scenes/000/scene.toml".into()];
        let alone = configuration_alone(config);
        assert!(alone.scenes.is_empty() && alone.from.is_none() && alone.validate().is_ok());
    }

    #[test]
    fn metadata_that_say_too_little_are_refused() {
        let nameless = PolicyFacts::read(None, "a file").unwrap_err().to_string();
        assert!(nameless.contains("orchestrator import"), "{nameless}");
        for name in ["config", "run", "rollout", "frames", "weights_sha256", "tensors_sha256"] {
            let mut facts = facts();
            facts.remove(name);
            let lacks = read(&facts).unwrap_err().to_string();
            assert!(lacks.contains(&format!("`{name}`")), "{lacks}");
        }
        let wrong = |name: &str, value: &str| {
            let mut facts = facts();
            facts.insert(name.to_owned(), value.to_owned());
            read(&facts).unwrap_err().to_string()
        };
        assert!(wrong("frames", "many").contains("`frames`"));
        assert!(wrong("config", "nonsense = 1").contains("configuration"));
    }
}
