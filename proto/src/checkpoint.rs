//! The manifest of a checkpoint: whose it is, the hashes of its other files, the run's position, and the conditions it
//! ran under. A learner writes it; learner and orchestrator read it.

use crate::bounded;
use crate::config::CarriedGoal;
use crate::digest::sha256;
use crate::run_folder::RunFolder;
use crate::trained::History;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Everything that the last bits of a result depend on. A run can resume under another environment, but not bit for
/// bit.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Machine {
    pub torch: String,
    /// `cpu` or `cuda`.
    pub device: String,
    /// Threads of libtorch on the CPU.
    pub threads: u32,
    /// `reproducible` where the CPU's results do not depend on the processor, else the instruction set of libtorch's
    /// kernels. (The key's name is older than the word.)
    #[serde(rename = "instruction_set")]
    pub arithmetic: String,
    /// Learners whose gradients are added up. 1 is not written, so that checkpoints of one learner keep their old form.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub learners: u32,
    /// Shards whose gradients are added up (`learner.shards`), if that is set: then the number of learners does not
    /// matter. 0 is not written.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub shards: u32,
}

fn one() -> u32 {
    1
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde's derive calls it so")]
fn is_one(learners: &u32) -> bool {
    *learners == 1
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde's derive calls it so")]
fn is_zero(shards: &u32) -> bool {
    *shards == 0
}

impl Machine {
    /// What differs, as text for a warning; empty when nothing does.
    pub fn differences(&self, stored: &Self) -> Vec<String> {
        // What the order of sums depends on.
        let (parts, were, are) = match [stored.shards, self.shards] {
            [0, 0] => ("learners", stored.learners, self.learners),
            [were, are] => ("shards", were, are),
        };
        [
            ("libtorch", &stored.torch, &self.torch),
            ("device", &stored.device, &self.device),
            ("threads", &stored.threads.to_string(), &self.threads.to_string()),
            ("CPU arithmetic", &stored.arithmetic, &self.arithmetic),
            (parts, &were.to_string(), &are.to_string()),
        ]
        .iter()
        .filter(|(_, then, now)| then != now)
        .map(|(what, then, now)| format!("{what} {now} instead of {then}"))
        .collect()
    }
}

fn older_sign() -> CarriedGoal {
    CarriedGoal::ObjectToGoal
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde's derive calls it so")]
fn is_older_sign(sign: &CarriedGoal) -> bool {
    *sign == older_sign()
}

/// The manifest. Written after the tensors: a checkpoint without one does not exist.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// [`crate::SCHEMA_VERSION`] of the writer.
    pub schema_version: u32,
    /// Id of the run that it belongs to. Empty where an older version wrote the checkpoint.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub run: String,
    /// First rollout that is not in it.
    pub rollout: u64,
    pub frames: u64,
    /// Exchange that the next rollout begins with.
    pub exchange: u64,
    /// Stage of the next rollout; the number of stages when the run is complete.
    pub stage: u32,
    /// True when a stage ended here: such a checkpoint is kept for good.
    pub stage_end: bool,
    /// Optimiser steps since the stage began.
    pub adam_steps: u64,
    #[serde(with = "exact")]
    pub multiplier: f64,
    /// Sign of the goal vector that the weights were trained with. The older sign is not written, so that checkpoints
    /// with it keep their old form.
    #[serde(default = "older_sign", skip_serializing_if = "is_older_sign")]
    pub carried_goal: CarriedGoal,
    /// File name of the tensors, in the same folder.
    pub tensors: String,
    pub tensors_bytes: u64,
    pub tensors_sha256: String,
    /// SHA-256 of the figures of all rollouts before it ([`crate::run_folder::RolloutName::Figures`]). Empty where an older version wrote
    /// the checkpoint, which has none.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub figures_sha256: String,
    /// SHA-256 of the effective configuration as TOML.
    pub config_sha256: String,
    /// That configuration: a resume under another one names what has changed. Empty where an older version wrote the
    /// checkpoint.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub config: String,
    /// Digest of the weights alone, as the summary shows it.
    pub weights: String,
    pub machine: Machine,
    /// SHA-256 of this manifest with this field empty.
    pub manifest_sha256: String,
}

/// A number as decimal text: readers of JSON numbers may change the last bit, and a resumed run must be exact. One
/// number has one text, so that no flipped bit goes unnoticed.
mod exact {
    use serde::de::Error;
    use serde::{Deserialize, Deserializer, Serializer};

    #[expect(clippy::trivially_copy_pass_by_ref, reason = "serde's derive calls it so")]
    pub fn serialize<S: Serializer>(value: &f64, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(value)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
        let text = String::deserialize(deserializer)?;
        let value: f64 = text.parse().map_err(|_| D::Error::custom(format!("`{text}` is not a number")))?;
        if value.to_string() == text { Ok(value) } else { Err(D::Error::custom(format!("`{text}` is not {value}"))) }
    }
}

#[derive(Debug, thiserror::Error)]
pub enum ManifestError {
    #[error("cannot be read: {0}")]
    Unreadable(#[from] std::io::Error),
    #[error("is not a manifest: {0}")]
    Json(#[from] serde_json::Error),
    #[error("has schema version {found}; this program reads {}", crate::SCHEMA_VERSION)]
    Version { found: u64 },
    #[error("does not match its own checksum")]
    Checksum,
}

/// The figures of a checkpoint cannot be used. Its weights may well be.
#[derive(Debug, thiserror::Error)]
#[error("{path} {problem}", path = .path.display())]
pub struct FiguresError {
    path: PathBuf,
    problem: String,
}

impl Manifest {
    /// The manifest as a file, its own checksum filled in.
    pub fn seal(mut self) -> Vec<u8> {
        self.manifest_sha256 = self.checksum();
        self.to_json()
    }

    /// Reads and verifies a file that [`Manifest::seal`] made. Whether the tensors are whole is another question.
    pub fn read(path: &Path) -> Result<Self, ManifestError> {
        Self::read_in(&RunFolder::new(path.parent().unwrap_or(Path::new(""))), path)
    }

    pub fn read_in(run: &RunFolder, path: &Path) -> Result<Self, ManifestError> {
        Self::open(&run.read(path, bounded::TEXT_BYTES_MOST)?)
    }

    pub fn open(bytes: &[u8]) -> Result<Self, ManifestError> {
        let value: serde_json::Value = serde_json::from_slice(bytes)?;
        // The version comes first: another one may have other fields.
        if let Some(found) = value.get("schema_version").and_then(serde_json::Value::as_u64)
            && found != u64::from(crate::SCHEMA_VERSION)
        {
            return Err(ManifestError::Version { found });
        }
        let manifest: Self = serde_json::from_value(value)?;
        if manifest.checksum() == manifest.manifest_sha256 { Ok(manifest) } else { Err(ManifestError::Checksum) }
    }

    /// Whether it belongs to another run than the one with this id. One that says nothing belongs to every run.
    pub fn is_of_another(&self, run: &str) -> bool {
        !self.run.is_empty() && self.run != run
    }

    /// The figures of all rollouts before this checkpoint of a run, whose file `read` reads; none where an older version
    /// wrote it.
    pub fn figures(
        &self,
        run: &RunFolder,
        read: impl FnOnce(&Path, u64) -> std::io::Result<Vec<u8>>,
    ) -> Result<Option<History>, FiguresError> {
        if self.figures_sha256.is_empty() {
            return Ok(None);
        }
        let path = run.checkpoint_figures(self.rollout);
        let bytes = read(&path, bounded::FIGURES_BYTES_MOST)
            .map_err(|cause| FiguresError { path: path.clone(), problem: format!("cannot be read: {cause}") })?;
        if sha256(&bytes) != self.figures_sha256 {
            return Err(FiguresError { path, problem: "does not match the checksum in its manifest".to_owned() });
        }
        Ok(Some(History::decode(&bytes).0))
    }

    fn checksum(&self) -> String {
        sha256(&Self { manifest_sha256: String::new(), ..self.clone() }.to_json())
    }

    fn to_json(&self) -> Vec<u8> {
        serde_json::to_vec_pretty(self).expect("numbers and strings always serialise")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn with_shards_the_number_of_learners_makes_no_difference() {
        let machine = |learners, shards| Machine { learners, shards, ..Machine::default() };
        assert_eq!(machine(1, 4).differences(&machine(4, 4)), [""; 0]);
        assert_eq!(machine(1, 0).differences(&machine(4, 0)), ["learners 1 instead of 4"]);
        assert_eq!(machine(2, 4).differences(&machine(2, 0)), ["shards 4 instead of 0"]);
        let text = serde_json::to_string(&machine(1, 0)).unwrap();
        assert!(!text.contains("shards") && !text.contains("learners"), "checkpoints keep their form: {text}");
        for machine in [machine(1, 0), machine(2, 4)] {
            assert_eq!(serde_json::from_str::<Machine>(&serde_json::to_string(&machine).unwrap()).unwrap(), machine);
        }
    }
}
