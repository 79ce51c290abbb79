//! Where checkpoints are kept: writing, finding the newest good one, deleting the old.

use super::Snapshot;
use super::tensors::{self, TensorsError};
use crate::agent::AgentState;
use proto::bounded::FIGURES_BYTES_MOST;
use proto::checkpoint::{Machine, Manifest, ManifestError};
use proto::config::StageConfig;
use proto::digest::{Digest256, sha256};
use proto::disk::{Disk, LocalDisk, TENSORS_BYTES_MOST};
use proto::pin::{pin, unpin};
use proto::run_folder::{RolloutName, RunFolder, write_pieces_atomically_on};
use proto::stage::position_at;
use proto::trained::History;
use std::io::ErrorKind;
use std::iter::once;
use std::path::{Path, PathBuf};

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rejected {
    pub path: PathBuf,
    pub reason: String,
}

impl std::fmt::Display for Rejected {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} {}", self.path.display(), self.reason)
    }
}

#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    #[error("cannot write checkpoint {path}: {cause} ({free_bytes} bytes are free there; earlier checkpoints are kept)",
        path = .path.display(), free_bytes = free_text(*.free_bytes))]
    Write { path: PathBuf, cause: std::io::Error, free_bytes: Option<u64> },
    #[error("cannot see recording {path} onto the disk: {cause} (the checkpoint is not written; earlier ones are kept)",
        path = .path.display())]
    Recording { path: PathBuf, cause: std::io::Error },
    #[error("cannot use checkpoint folder {path}: {cause}", path = .path.display())]
    Folder { path: PathBuf, cause: std::io::Error },
    #[error("cannot encode the state: {0}")]
    Encode(#[from] TensorsError),
    #[error("{folder} is not the folder of run {run} any more ({found}): nothing is written there", folder = .folder.display())]
    Foreign { folder: PathBuf, run: String, found: String },
    #[error("no checkpoint in {folder} can be used:\n{}", list(.rejected), folder = .folder.display())]
    NoneGood {
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

#[derive(Debug)]
pub struct Loaded {
    pub snapshot: Snapshot,
    pub manifest: Manifest,
    /// Path of the manifest, relative to the run folder.
    pub path: String,
    /// Newer checkpoints that could not be used.
    pub rejected: Vec<Rejected>,
    /// The figures of all rollouts before it, or why it holds none.
    pub figures: Result<History, String>,
}

#[derive(Debug, Clone)]
pub struct Store<D = LocalDisk> {
    disk: D,
    run: RunFolder,
    /// The run's id. Empty where nobody gave it one: then nothing is compared with it.
    id: String,
    /// The run is still being made: `run.toml`, which says whose the folder is, comes last.
    unmade: bool,
    stages: Vec<StageConfig>,
    config: String,
    machine: Machine,
    keep: usize,
}

impl Store {
    /// The checkpoints of `run`. The `keep` newest are kept, and the one at each stage's end.
    pub fn new(
        (run, id): (RunFolder, &str),
        stages: &[StageConfig],
        config_toml: &str,
        machine: Machine,
        keep: u32,
    ) -> Self {
        let (id, stages, config) = (id.to_owned(), stages.to_vec(), config_toml.to_owned());
        Self { disk: LocalDisk, run, id, unmade: false, stages, config, machine, keep: keep as usize }
    }

    /// The same for a run that is still being made.
    pub(crate) fn of_unmade(self) -> Self {
        Self { unmade: true, ..self }
    }

    pub fn on<D: Disk>(self, disk: D) -> Store<D> {
        let Self { disk: _, run, id, unmade, stages, config, machine, keep } = self;
        Store { disk, run, id, unmade, stages, config, machine, keep }
    }
}

impl<D: Disk> Store<D> {
    /// Fails if the folder is another run's, or nobody's: it was removed, and perhaps made anew, while we worked.
    pub(crate) fn check_run(&self) -> Result<(), CheckpointError> {
        let found = match self.run.id() {
            _ if self.id.is_empty() || self.unmade => return Ok(()),
            Some(id) if id == self.id => return Ok(()),
            Some(id) => format!("it is that of run {id}"),
            None => format!("{} is gone or damaged", self.run.identity().display()),
        };
        Err(CheckpointError::Foreign { folder: self.run.root().to_path_buf(), run: self.id.clone(), found })
    }

    pub fn machine(&self) -> &Machine {
        &self.machine
    }

    /// Writes a checkpoint, with the figures of all rollouts before it, then deletes those that need not be kept. The
    /// recordings, which hold everything up to it, are on the disk before it counts. Returns the manifest's path relative
    /// to the run folder. After an error everything that was there before is still there. `evaluated`: it is to be
    /// evaluated, so it is pinned, too.
    pub fn save(&self, snapshot: &Snapshot, figures: &History, evaluated: bool) -> Result<String, CheckpointError> {
        wire::fault::reach("learner.before_checkpoint");
        self.check_run()?;
        let folder = self.run.checkpoints();
        self.disk.create_folders(&folder).map_err(|cause| CheckpointError::Folder { path: folder.clone(), cause })?;
        let tensors_path = self.run.checkpoint_tensors(snapshot.rollout);
        let manifest_path = self.run.checkpoint_manifest(snapshot.rollout);
        let bytes = tensors::encode(&snapshot.agent.tensors, &snapshot.boundary)?;
        let position = position_at(&self.stages, snapshot.frames);
        let mut manifest = Manifest {
            schema_version: proto::SCHEMA_VERSION,
            run: self.id.clone(),
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
            figures_sha256: String::new(),
            config_sha256: sha256(self.config.as_bytes()),
            config: self.config.clone(),
            weights: snapshot.weights.clone(),
            machine: self.machine.clone(),
            manifest_sha256: String::new(),
        };
        self.write(&tensors_path, once(bytes))?;
        wire::fault::reach("learner.after_tensors");
        let mut digest = Digest256::default();
        let pieces = figures.pieces().inspect(|piece| digest.add(piece));
        self.write(&self.run.checkpoint_figures(snapshot.rollout), pieces)?;
        manifest.figures_sha256 = digest.finish();
        wire::fault::reach("learner.after_figures");
        self.sync_recordings()?;
        wire::fault::reach("learner.after_sync");
        // Again: a learner that was stopped for long while it wrote may find another run's folder.
        self.check_run()?;
        self.write(&manifest_path, once(manifest.seal()))?;
        wire::fault::reach("learner.after_manifest");
        // One that was pinned before this learner went back may be damaged.
        if evaluated
            && let Err(cause) = unpin(&self.run, snapshot.rollout).and_then(|()| pin(&self.run, snapshot.rollout))
        {
            tracing::warn!("the checkpoint at {} frames is not kept for its evaluation: {cause}", snapshot.frames);
        }
        wire::fault::reach("learner.after_pin");
        self.prune(snapshot.rollout);
        wire::fault::reach("learner.after_prune");
        Ok(relative(&self.run, &manifest_path))
    }

    /// The newest good checkpoint; none when none was ever completed. Those of other runs do not count.
    pub fn load(&self) -> Result<Option<Loaded>, CheckpointError> {
        let folder = self.run.checkpoints();
        let rollouts = match self.rollouts() {
            Ok(rollouts) => rollouts,
            Err(cause) if cause.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(cause) => return Err(CheckpointError::Folder { path: folder, cause }),
        };
        let mut rejected = vec![];
        for rollout in rollouts.into_iter().rev() {
            let manifest_path = self.run.checkpoint_manifest(rollout);
            let manifest = self.manifest(rollout);
            if let Ok(manifest) = &manifest
                && manifest.is_of_another(&self.id)
            {
                let path = manifest_path.display();
                tracing::warn!(
                    "checkpoint passed over: {path} is of run {}, and this is run {}",
                    manifest.run,
                    self.id
                );
                continue;
            }
            match self.open(rollout, manifest) {
                Ok((snapshot, manifest)) => {
                    let path = relative(&self.run, &manifest_path);
                    let figures = match manifest.figures(&self.run, |path, most| self.disk.read(path, most)) {
                        Ok(Some(figures)) => Ok(figures),
                        Ok(None) => Err(format!("{path} is of an older version")),
                        Err(error) => Err(error.to_string()),
                    };
                    return Ok(Some(Loaded { snapshot, manifest, path, rejected, figures }));
                }
                Err(reason) => rejected.push(reason),
            }
        }
        if rejected.is_empty() { Ok(None) } else { Err(CheckpointError::NoneGood { folder, rejected }) }
    }

    /// The figures of the rollouts before this one in `metrics.jsonl`, as far as it has them.
    pub(crate) fn figures_of_file(&self, rollout: u64) -> History {
        let (mut figures, _) =
            self.run.reader(&self.run.metrics(), FIGURES_BYTES_MOST).and_then(History::read).unwrap_or_default();
        figures.rewind_to(rollout);
        figures
    }

    fn open(&self, rollout: u64, manifest: Result<Manifest, String>) -> Result<(Snapshot, Manifest), Rejected> {
        let manifest_path = self.run.checkpoint_manifest(rollout);
        let tensors_path = self.run.checkpoint_tensors(rollout);
        let at = |path: &Path, reason: String| Rejected { path: path.to_path_buf(), reason };
        let manifest = manifest.map_err(|reason| at(&manifest_path, reason))?;
        if manifest.rollout != rollout || manifest.tensors != file_name(&tensors_path) {
            return Err(at(&manifest_path, format!("is the manifest of rollout {}", manifest.rollout)));
        }
        Ok((tensors_of(&self.disk, &manifest, &tensors_path)?, manifest))
    }

    fn manifest(&self, rollout: u64) -> Result<Manifest, String> {
        let bytes =
            self.disk.read(&self.run.checkpoint_manifest(rollout), TENSORS_BYTES_MOST).map_err(ManifestError::from);
        bytes.and_then(|bytes| Manifest::open(&bytes)).map_err(|cause| cause.to_string())
    }

    /// Rollouts that have a manifest, ascending.
    fn rollouts(&self) -> std::io::Result<Vec<u64>> {
        let names = self.disk.list(&self.run.checkpoints())?;
        let mut rollouts: Vec<u64> = names.iter().filter_map(|path| RolloutName::Manifest.rollout_of(path)).collect();
        rollouts.sort_unstable();
        Ok(rollouts)
    }

    /// Deletes what need not be kept, now that the checkpoint of rollout `newest` is complete. A file that cannot be
    /// deleted only takes space, so it is no error.
    ///
    /// Checkpoints newer than `newest` are unusable, otherwise the run would have resumed from them. They are kept for
    /// inspection until the run reaches their rollout again. Older unusable ones do not count as kept.
    pub(crate) fn prune(&self, newest: u64) {
        let Ok(mut rollouts) = self.rollouts() else { return };
        rollouts.retain(|&rollout| rollout <= newest);
        let mut kept = 0;
        for rollout in rollouts.into_iter().rev() {
            let whole = self.manifest(rollout).ok().filter(|manifest| {
                let bytes = self.disk.size(&self.run.checkpoint_tensors(rollout));
                bytes.is_ok_and(|bytes| bytes == manifest.tensors_bytes) && !manifest.is_of_another(&self.id)
            });
            if whole.is_some() && kept < self.keep {
                kept += 1;
                continue;
            }
            if whole.is_some_and(|manifest| manifest.stage_end) {
                continue;
            }
            // The manifest first: without it the rest does not count.
            for kind in [RolloutName::Manifest, RolloutName::Tensors, RolloutName::Figures] {
                let path = self.run.checkpoints().join(kind.of(rollout));
                match self.disk.remove(&path) {
                    Err(cause) if cause.kind() != std::io::ErrorKind::NotFound => {
                        tracing::warn!("cannot delete old checkpoint {}: {cause}", path.display());
                    }
                    _ => {}
                }
            }
        }
        self.sweep_fragments();
    }

    /// Deletes the remains of a process that died while it wrote: temporary files, and others without a manifest.
    fn sweep_fragments(&self) {
        let Ok(paths) = self.disk.list(&self.run.checkpoints()) else { return };
        let has_manifest = |rollout| paths.contains(&self.run.checkpoint_manifest(rollout));
        for path in &paths {
            let temporary = path.extension().is_some_and(|extension| extension == "partial");
            let rollout = RolloutName::Tensors.rollout_of(path).or_else(|| RolloutName::Figures.rollout_of(path));
            let orphan = rollout.is_some_and(|rollout| !has_manifest(rollout));
            if temporary || orphan {
                let _ = self.disk.remove(path);
            }
        }
    }

    fn write<B: AsRef<[u8]>>(&self, path: &Path, pieces: impl Iterator<Item = B>) -> Result<(), CheckpointError> {
        write_pieces_atomically_on(&self.disk, path, pieces).map_err(|cause| CheckpointError::Write {
            path: path.to_path_buf(),
            cause,
            free_bytes: path.parent().and_then(free_bytes),
        })
    }

    /// Has all recordings and their names written to the disk. Those that are there already cost next to nothing.
    pub(crate) fn sync_recordings(&self) -> Result<(), CheckpointError> {
        let folder = self.run.recordings();
        let failed = |path: &Path, cause| CheckpointError::Recording { path: path.to_path_buf(), cause };
        let paths = match self.disk.list(&folder) {
            Ok(paths) => paths,
            Err(cause) if cause.kind() == ErrorKind::NotFound => return Ok(()),
            Err(cause) => return Err(failed(&folder, cause)),
        };
        for path in paths.iter().filter(|path| path.extension().is_some_and(|extension| extension == "mcap")) {
            match self.disk.open(path).and_then(|file| self.disk.sync(&file)) {
                // Somebody has moved or deleted it, or it is no plain file: it is not ours to keep.
                Err(cause) if matches!(cause.kind(), ErrorKind::NotFound | ErrorKind::InvalidInput) => {}
                synced => synced.map_err(|cause| failed(path, cause))?,
            }
        }
        self.disk.sync_folder(&folder).map_err(|cause| failed(&folder, cause))
    }
}

/// Rollouts, frames and exchanges of a run: each leaves room for the next.
const COUNT_MOST: u64 = 1 << 60;

/// Reads the checkpoint with this manifest, wherever it lies, and verifies it. Its figures are left out.
pub fn read(manifest_path: &Path) -> Result<(Snapshot, Manifest), Rejected> {
    let manifest = Manifest::read(manifest_path)
        .map_err(|cause| Rejected { path: manifest_path.to_path_buf(), reason: cause.to_string() })?;
    if Path::new(&manifest.tensors).file_name() != Some(manifest.tensors.as_ref()) {
        let reason = format!("names tensors that are not beside it: {}", manifest.tensors);
        return Err(Rejected { path: manifest_path.to_path_buf(), reason });
    }
    let tensors_path = manifest_path.with_file_name(&manifest.tensors);
    Ok((tensors_of(&LocalDisk, &manifest, &tensors_path)?, manifest))
}

/// The state in the tensor file that belongs to a manifest.
fn tensors_of<D: Disk>(disk: &D, manifest: &Manifest, path: &Path) -> Result<Snapshot, Rejected> {
    let at = |reason: String| Rejected { path: path.to_path_buf(), reason };
    let bytes = disk.read(path, TENSORS_BYTES_MOST).map_err(|cause| at(format!("cannot be read: {cause}")))?;
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
