//! Where checkpoints are kept: writing, finding the newest good one, deleting the old.

use super::Snapshot;
use super::tensors::{self, TensorsError};
use crate::agent::AgentState;
use proto::bounded;
use proto::checkpoint::{Machine, Manifest};
use proto::config::StageConfig;
use proto::digest::sha256;
use proto::run_folder::{RolloutName, RunFolder, write_atomically};
use proto::stage::position_at;
use std::path::{Path, PathBuf};

/// A checkpoint that cannot be used, and why.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rejected {
    /// The file at fault.
    pub path: PathBuf,
    /// What is wrong with it.
    pub reason: String,
}

impl std::fmt::Display for Rejected {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} {}", self.path.display(), self.reason)
    }
}

/// A failure to write or to find a checkpoint.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    /// A file could not be written. What was there before is still there.
    #[error("cannot write checkpoint {path}: {cause} ({free_bytes} bytes are free there; earlier checkpoints are kept)",
        path = .path.display(), free_bytes = free_text(*.free_bytes))]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        cause: std::io::Error,
        /// Free space on its file system, if known.
        free_bytes: Option<u64>,
    },
    /// The folder could not be read or created.
    #[error("cannot use checkpoint folder {path}: {cause}", path = .path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
        /// Why.
        cause: std::io::Error,
    },
    /// The state could not be turned into a file.
    #[error("cannot encode the state: {0}")]
    Encode(#[from] TensorsError),
    /// There are checkpoints, and none can be used.
    #[error("no checkpoint in {folder} can be used:\n{}", list(.rejected), folder = .folder.display())]
    NoneGood {
        /// The folder.
        folder: PathBuf,
        /// Each with its reason, newest first.
        rejected: Vec<Rejected>,
    },
}

fn free_text(free_bytes: Option<u64>) -> String {
    free_bytes.map_or_else(|| "an unknown number of".to_owned(), |bytes| bytes.to_string())
}

fn list(rejected: &[Rejected]) -> String {
    rejected.iter().map(|rejected| format!("  {rejected}")).collect::<Vec<_>>().join("\n")
}

/// The newest good checkpoint, and the newer unusable ones that were skipped.
#[derive(Debug)]
pub struct Loaded {
    /// The state.
    pub snapshot: Snapshot,
    /// Its manifest.
    pub manifest: Manifest,
    /// Path of the manifest, relative to the run folder.
    pub path: String,
    /// Newer checkpoints that could not be used.
    pub rejected: Vec<Rejected>,
}

/// The checkpoints of one run.
#[derive(Debug, Clone)]
pub struct Store {
    run: RunFolder,
    stages: Vec<StageConfig>,
    config: String,
    machine: Machine,
    keep: usize,
}

impl Store {
    /// The checkpoints of `run`. The `keep` newest are kept, and the one at each stage's end.
    pub fn new(run: RunFolder, stages: &[StageConfig], config_toml: &str, machine: Machine, keep: u32) -> Self {
        Self { run, stages: stages.to_vec(), config: config_toml.to_owned(), machine, keep: keep as usize }
    }

    /// The machine that new checkpoints carry.
    pub fn machine(&self) -> &Machine {
        &self.machine
    }

    /// Writes a checkpoint, then deletes those that need not be kept. Returns the manifest's path relative to the run
    /// folder. After an error everything that was there before is still there.
    pub fn save(&self, snapshot: &Snapshot) -> Result<String, CheckpointError> {
        wire::fault::reach("learner.before_checkpoint");
        let folder = self.run.checkpoints();
        std::fs::create_dir_all(&folder).map_err(|cause| CheckpointError::Folder { path: folder.clone(), cause })?;
        let tensors_path = self.run.checkpoint_tensors(snapshot.rollout);
        let manifest_path = self.run.checkpoint_manifest(snapshot.rollout);
        let bytes = tensors::encode(&snapshot.agent.tensors, &snapshot.boundary)?;
        let position = position_at(&self.stages, snapshot.frames);
        let manifest = Manifest {
            schema_version: proto::SCHEMA_VERSION,
            rollout: snapshot.rollout,
            frames: snapshot.frames,
            exchange: snapshot.boundary.exchange,
            stage: position.map_or(self.stages.len(), |position| position.stage) as u32,
            stage_end: snapshot.frames > 0 && position.is_none_or(|position| position.frames_in_stage == 0),
            adam_steps: snapshot.agent.adam_steps,
            multiplier: snapshot.agent.multiplier,
            carried_goal: snapshot.agent.carried_goal,
            tensors: file_name(&tensors_path),
            tensors_bytes: bytes.len() as u64,
            tensors_sha256: sha256(&bytes),
            config_sha256: sha256(self.config.as_bytes()),
            config: self.config.clone(),
            weights: snapshot.weights.clone(),
            machine: self.machine.clone(),
            manifest_sha256: String::new(),
        };
        write(&tensors_path, &bytes)?;
        wire::fault::reach("learner.after_tensors");
        write(&manifest_path, &manifest.seal())?;
        wire::fault::reach("learner.after_manifest");
        self.prune(snapshot.rollout);
        Ok(relative(&self.run, &manifest_path))
    }

    /// The newest good checkpoint; none when none was ever completed.
    pub fn load(&self) -> Result<Option<Loaded>, CheckpointError> {
        let folder = self.run.checkpoints();
        let rollouts = match self.rollouts() {
            Ok(rollouts) => rollouts,
            Err(cause) if cause.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(cause) => return Err(CheckpointError::Folder { path: folder, cause }),
        };
        let mut rejected = vec![];
        for rollout in rollouts.into_iter().rev() {
            match self.open(rollout) {
                Ok((snapshot, manifest)) => {
                    let path = relative(&self.run, &self.run.checkpoint_manifest(rollout));
                    return Ok(Some(Loaded { snapshot, manifest, path, rejected }));
                }
                Err(reason) => rejected.push(reason),
            }
        }
        if rejected.is_empty() { Ok(None) } else { Err(CheckpointError::NoneGood { folder, rejected }) }
    }

    fn open(&self, rollout: u64) -> Result<(Snapshot, Manifest), Rejected> {
        let manifest_path = self.run.checkpoint_manifest(rollout);
        let tensors_path = self.run.checkpoint_tensors(rollout);
        let at = |path: &Path, reason: String| Rejected { path: path.to_path_buf(), reason };
        let manifest = self.manifest(rollout).map_err(|reason| at(&manifest_path, reason))?;
        if manifest.rollout != rollout || manifest.tensors != file_name(&tensors_path) {
            return Err(at(&manifest_path, format!("is the manifest of rollout {}", manifest.rollout)));
        }
        Ok((tensors_of(&manifest, &tensors_path)?, manifest))
    }

    fn manifest(&self, rollout: u64) -> Result<Manifest, String> {
        Manifest::read(&self.run.checkpoint_manifest(rollout)).map_err(|cause| cause.to_string())
    }

    /// Rollouts that have a manifest, ascending.
    fn rollouts(&self) -> std::io::Result<Vec<u64>> {
        let mut rollouts = vec![];
        for entry in std::fs::read_dir(self.run.checkpoints())? {
            rollouts.extend(RolloutName::Manifest.rollout_of(&entry?.path()));
        }
        rollouts.sort_unstable();
        Ok(rollouts)
    }

    /// Deletes what need not be kept, now that the checkpoint of rollout `newest` is complete. A file that cannot be
    /// deleted only takes space, so it is no error.
    ///
    /// Checkpoints newer than `newest` are unusable, otherwise the run would have resumed from them. They are kept for
    /// inspection until the run reaches their rollout again. Older unusable ones do not count as kept.
    fn prune(&self, newest: u64) {
        let Ok(mut rollouts) = self.rollouts() else { return };
        rollouts.retain(|&rollout| rollout <= newest);
        let mut kept = 0;
        for rollout in rollouts.into_iter().rev() {
            let whole = self.manifest(rollout).ok().filter(|manifest| {
                let tensors = std::fs::metadata(self.run.checkpoint_tensors(rollout));
                tensors.is_ok_and(|file| file.len() == manifest.tensors_bytes)
            });
            if whole.is_some() && kept < self.keep {
                kept += 1;
                continue;
            }
            if whole.is_some_and(|manifest| manifest.stage_end) {
                continue;
            }
            // The manifest first: without it the rest does not count.
            for path in [self.run.checkpoint_manifest(rollout), self.run.checkpoint_tensors(rollout)] {
                match std::fs::remove_file(&path) {
                    Err(cause) if cause.kind() != std::io::ErrorKind::NotFound => {
                        tracing::warn!("cannot delete old checkpoint {}: {cause}", path.display());
                    }
                    _ => {}
                }
            }
        }
        self.sweep_fragments();
    }

    /// Deletes the remains of a process that died while it wrote: temporary files, and tensors without a manifest.
    fn sweep_fragments(&self) {
        let Ok(entries) = std::fs::read_dir(self.run.checkpoints()) else { return };
        for path in entries.filter_map(|entry| entry.ok().map(|entry| entry.path())) {
            let temporary = path.extension().is_some_and(|extension| extension == "partial");
            let orphan = RolloutName::Tensors
                .rollout_of(&path)
                .is_some_and(|rollout| !self.run.checkpoint_manifest(rollout).exists());
            if temporary || orphan {
                let _ = std::fs::remove_file(&path);
            }
        }
    }
}

/// Rollouts, frames and exchanges of a run: each leaves room for the next.
const COUNT_MOST: u64 = 1 << 60;
/// Tensors of a checkpoint, bytes: the largest network with the most environments has a tenth.
const TENSORS_BYTES_MOST: u64 = 64 << 30;

/// Reads the checkpoint with this manifest, in any folder, and verifies it.
pub fn read(manifest_path: &Path) -> Result<(Snapshot, Manifest), Rejected> {
    let manifest = Manifest::read(manifest_path)
        .map_err(|cause| Rejected { path: manifest_path.to_path_buf(), reason: cause.to_string() })?;
    if Path::new(&manifest.tensors).file_name() != Some(manifest.tensors.as_ref()) {
        let reason = format!("names tensors that are not beside it: {}", manifest.tensors);
        return Err(Rejected { path: manifest_path.to_path_buf(), reason });
    }
    let tensors_path = manifest_path.with_file_name(&manifest.tensors);
    Ok((tensors_of(&manifest, &tensors_path)?, manifest))
}

/// The state in the tensor file that belongs to a manifest.
fn tensors_of(manifest: &Manifest, path: &Path) -> Result<Snapshot, Rejected> {
    let at = |reason: String| Rejected { path: path.to_path_buf(), reason };
    let bytes = bounded::read(path, TENSORS_BYTES_MOST).map_err(|cause| at(format!("cannot be read: {cause}")))?;
    if bytes.len() as u64 != manifest.tensors_bytes {
        return Err(at(format!("is torn: it has {} bytes of {}", bytes.len(), manifest.tensors_bytes)));
    }
    let digest = sha256(&bytes);
    if digest != manifest.tensors_sha256 {
        return Err(at(format!("is corrupt: its SHA-256 is {digest}, its manifest says {}", manifest.tensors_sha256)));
    }
    let Manifest { rollout, frames, exchange, adam_steps, multiplier, carried_goal, .. } = *manifest;
    if let Some(count) = [rollout, frames, exchange].into_iter().find(|&count| count > COUNT_MOST) {
        return Err(at(format!("cannot be used: its manifest counts to {count}, and no run gets so far")));
    }
    let (tensors, boundary) =
        tensors::decode(&bytes, exchange).map_err(|cause| at(format!("cannot be used: {cause}")))?;
    let agent = AgentState { tensors, adam_steps, multiplier, carried_goal };
    Ok(Snapshot { rollout, frames, agent, boundary, weights: manifest.weights.clone() })
}

fn write(path: &Path, content: &[u8]) -> Result<(), CheckpointError> {
    write_atomically(path, content).map_err(|cause| CheckpointError::Write {
        path: path.to_path_buf(),
        cause,
        free_bytes: path.parent().and_then(free_bytes),
    })
}

/// Bytes that this process may still write to the file system of a folder.
fn free_bytes(folder: &Path) -> Option<u64> {
    rustix::fs::statvfs(folder).ok().map(|status| status.f_bavail * status.f_frsize)
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

fn relative(run: &RunFolder, path: &Path) -> String {
    path.strip_prefix(run.root()).unwrap_or(path).display().to_string()
}
