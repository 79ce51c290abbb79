//! Layout of a run folder. Every path in it is made here.
//!
//! ```text
//! RUN/
//!   run.toml               identity of the run: id, schema version, incarnations so far
//!   config.toml            effective configuration; only `resume` with another budget or shape and `scale` replace it
//!   scale.toml             what `orchestrator scale` asks for, until the orchestrator has taken it
//!   orchestrator.lock      held (flock) by the orchestrator that runs it
//!   learner-0.lock, ...    held by the learner of that rank while it lives
//!   scenes/000/            copies of the scenes it trains in, if it has its own
//!   kitchens/1007.kitchen  procedural kitchens that were made for it, settled; one that is missing is made anew
//!   checkpoints/           rollout-00000012.safetensors, rollout-00000012.jsonl (figures of all rollouts before it) and
//!                          rollout-00000012.json (manifest, written last)
//!   recordings/            incarnation-001.000.mcap, ...
//!   hosts/001/             of a run on several hosts: recordings and logs of host 1, and copies of what its processes read
//!   logs/                  orchestrator.log, learner-0.log, ..., actor-00.log, ...
//!   metrics.jsonl          one line a trained rollout; what is missing is taken from the checkpoint
//!   tensorboard/           event files of the same figures: a folder for each stage, and validation/
//!   validation.jsonl       one line an evaluation made while it trained
//!   validation/rollout-00000012/   its result; the checkpoint, too, until it is known not to be the best
//!   best -> validation/rollout-00000012   the best checkpoint so far
//!   evaluations/           what `orchestrator eval RUN` made
//!   nonfinite-rollout-12.safetensors   the batch of an update that met a number that is not finite
//!   summary.json           written when the budget is reached
//! ```

use crate::bounded;
use crate::disk::{Disk, LocalDisk};
use crate::fault;
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// The same path, as `./-x` where it begins with a dash: no program that is given it takes it for a flag.
pub fn unlike_a_flag(path: impl Into<PathBuf>) -> PathBuf {
    let path = path.into();
    if path.as_os_str().as_encoded_bytes().starts_with(b"-") { Path::new(".").join(path) } else { path }
}

/// A run folder, existing or about to be created.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RunFolder {
    root: PathBuf,
}

impl RunFolder {
    /// The folder at `root`.
    pub fn new(root: impl Into<PathBuf>) -> Self {
        Self { root: unlike_a_flag(root) }
    }

    /// The folder itself.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Identity of the run.
    pub fn identity(&self) -> PathBuf {
        self.root.join("run.toml")
    }

    /// The id in `run.toml`; none where there is none that can be read.
    pub fn id(&self) -> Option<String> {
        #[derive(Deserialize)]
        struct Named {
            id: String,
        }
        let text = bounded::read_text(&self.identity()).ok()?;
        toml::from_str(&text).ok().map(|Named { id }| id)
    }

    /// Effective configuration.
    pub fn config(&self) -> PathBuf {
        self.root.join("config.toml")
    }

    /// Another number of actors that is asked for.
    pub fn scale_request(&self) -> PathBuf {
        self.root.join("scale.toml")
    }

    /// Lock of the orchestrator.
    pub fn orchestrator_lock(&self) -> PathBuf {
        self.root.join("orchestrator.lock")
    }

    /// Lock of a learner: only its holder may write checkpoints.
    pub fn learner_lock(&self, rank: u32) -> PathBuf {
        self.root.join(format!("learner-{rank}.lock"))
    }

    /// Folder of checkpoints.
    pub fn checkpoints(&self) -> PathBuf {
        self.root.join("checkpoints")
    }

    /// Tensors of the checkpoint whose first missing rollout is `rollout`.
    pub fn checkpoint_tensors(&self, rollout: u64) -> PathBuf {
        self.checkpoints().join(RolloutName::Tensors.of(rollout))
    }

    /// Figures of all rollouts before that checkpoint.
    pub fn checkpoint_figures(&self, rollout: u64) -> PathBuf {
        self.checkpoints().join(RolloutName::Figures.of(rollout))
    }

    /// Manifest of that checkpoint. It is written last: a checkpoint without one does not exist.
    pub fn checkpoint_manifest(&self, rollout: u64) -> PathBuf {
        self.checkpoints().join(RolloutName::Manifest.of(rollout))
    }

    /// Folder of its copies of scenes.
    pub fn scenes(&self) -> PathBuf {
        self.root.join("scenes")
    }

    /// Copy of the run's scene number `index` with all its files.
    pub fn scene(&self, index: usize) -> PathBuf {
        self.root.join(self.relative_scene(index))
    }

    /// The same, relative to the folder: what the effective configuration names.
    pub fn relative_scene(&self, index: usize) -> String {
        format!("scenes/{index:03}")
    }

    /// Folder of its procedural kitchens.
    pub fn kitchens(&self) -> PathBuf {
        self.root.join("kitchens")
    }

    /// The run folder of a recording, if the recording is where [`RunFolder::recording`] puts it.
    pub fn of_recording(recording: &Path) -> Option<Self> {
        let recordings = recording.parent()?;
        let root = recordings.parent()?;
        (recordings.file_name()? == "recordings").then(|| Self::new(root))
    }

    /// Folder of recordings.
    pub fn recordings(&self) -> PathBuf {
        self.root.join("recordings")
    }

    /// One MCAP segment of one incarnation.
    pub fn recording(&self, incarnation: u32, segment: u32) -> PathBuf {
        self.recordings().join(format!("incarnation-{incarnation:03}.{segment:03}.mcap"))
    }

    /// The folder of another host of the run: it holds what is made there, in the same layout.
    #[must_use]
    pub fn host(&self, host: u32) -> Self {
        Self::new(self.hosts().join(format!("{host:03}")))
    }

    /// The folders of other hosts that are here, in order.
    pub fn host_folders(&self) -> Vec<Self> {
        let entries = std::fs::read_dir(self.hosts()).into_iter().flatten().flatten().map(|entry| entry.path());
        let is_hosts = |path: &PathBuf| {
            let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
            path.is_dir() && name.parse::<u32>().is_ok()
        };
        let mut folders: Vec<PathBuf> = entries.filter(is_hosts).collect();
        folders.sort();
        folders.into_iter().map(Self::new).collect()
    }

    /// Folder of the other hosts' folders.
    pub fn hosts(&self) -> PathBuf {
        self.root.join("hosts")
    }

    /// Folder of logs.
    pub fn logs(&self) -> PathBuf {
        self.root.join("logs")
    }

    /// Log of the process with this name.
    pub fn log(&self, process: &str) -> PathBuf {
        self.logs().join(format!("{process}.log"))
    }

    /// One line a trained rollout.
    pub fn metrics(&self) -> PathBuf {
        self.root.join("metrics.jsonl")
    }

    /// Folder of TensorBoard event files.
    pub fn tensorboard(&self) -> PathBuf {
        self.root.join("tensorboard")
    }

    /// One line an evaluation made while it trained.
    pub fn validation_log(&self) -> PathBuf {
        self.root.join("validation.jsonl")
    }

    /// Folder of the evaluations made while it trained.
    pub fn validations(&self) -> PathBuf {
        self.root.join("validation")
    }

    /// The one of the checkpoint whose first missing rollout is `rollout`.
    pub fn validation(&self, rollout: u64) -> PathBuf {
        self.root.join(Self::relative_validation(rollout))
    }

    /// The same, relative to the folder: what [`RunFolder::best`] points to.
    pub fn relative_validation(rollout: u64) -> String {
        format!("validation/{}", RolloutName::Folder.of(rollout))
    }

    /// The best checkpoint so far by validation: a symbolic link to its folder.
    pub fn best(&self) -> PathBuf {
        self.root.join(BEST)
    }

    /// The batch of rollout `rollout`, whose update met a number that is not finite: the part of one learner.
    pub fn nonfinite_dump(&self, rollout: u64, rank: u32) -> PathBuf {
        let learner = if rank > 0 { format!("-learner-{rank}") } else { String::new() };
        self.root.join(format!("nonfinite-rollout-{rollout}{learner}.safetensors"))
    }

    /// Summary of a complete run.
    pub fn summary(&self) -> PathBuf {
        self.root.join("summary.json")
    }
}

/// A file named after a rollout, in any folder. Such names are made and read only here.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RolloutName {
    /// Manifest of a checkpoint: `rollout-00000012.json`.
    Manifest,
    /// Its tensors, beside it: `rollout-00000012.safetensors`.
    Tensors,
    /// The figures of all rollouts before it: `rollout-00000012.jsonl`.
    Figures,
    /// Folder of a validation: `rollout-00000012`.
    Folder,
}

impl RolloutName {
    /// The name for this rollout.
    pub fn of(self, rollout: u64) -> String {
        let dot = if self.extension().is_empty() { "" } else { "." };
        format!("{PREFIX}{rollout:08}{dot}{}", self.extension())
    }

    /// The rollout that the last part of a path names; none where it is another kind of name.
    pub fn rollout_of(self, path: &Path) -> Option<u64> {
        if path.extension().unwrap_or_default() != self.extension() {
            return None;
        }
        path.file_stem()?.to_str()?.strip_prefix(PREFIX)?.parse().ok()
    }

    fn extension(self) -> &'static str {
        match self {
            Self::Manifest => "json",
            Self::Tensors => "safetensors",
            Self::Figures => "jsonl",
            Self::Folder => "",
        }
    }
}

/// Name of the link to the best checkpoint by validation.
pub const BEST: &str = "best";

/// What all names of rollouts begin with.
const PREFIX: &str = "rollout-";

/// What the name of a file ends in while [`write_atomically`] writes it.
pub const PARTIAL: &str = ".partial";

/// Writes a file so that a reader finds either the old content or the new, whole: temporary file in the same folder,
/// fsync, rename, fsync of the folder.
pub fn write_atomically(path: &Path, content: &[u8]) -> std::io::Result<()> {
    write_pieces_atomically_on(&LocalDisk, path, std::iter::once(content))
}

/// The same on any file system, of a content that is not in memory as a whole.
pub fn write_pieces_atomically_on<D: Disk, B: AsRef<[u8]>>(
    disk: &D,
    path: &Path,
    mut pieces: impl Iterator<Item = B>,
) -> std::io::Result<()> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut temporary = path.as_os_str().to_owned();
    temporary.push(PARTIAL);
    let temporary = PathBuf::from(temporary);
    fault::reach("file.before_write");
    // One that a crash left gives way. Made anew, it cannot be a link to a file elsewhere.
    match disk.remove(&temporary) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    let written = disk.create_new(&temporary).and_then(|mut file| {
        pieces.try_for_each(|piece| disk.write_all(&mut file, piece.as_ref()))?;
        fault::reach("file.before_fsync");
        disk.sync(&file)
    });
    let renamed = written.and_then(|()| {
        fault::reach("file.before_rename");
        disk.rename(&temporary, path)
    });
    if let Err(error) = renamed {
        // A full disk leaves nothing behind but the error, nor does a folder in the file's place.
        let _ = disk.remove(&temporary);
        return Err(error);
    }
    fault::reach("file.after_rename");
    disk.sync_folder(folder)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recording_knows_its_run() {
        let run = RunFolder::new("runs/a");
        assert_eq!(RunFolder::of_recording(&run.recording(1, 0)), Some(run));
        assert_eq!(RunFolder::of_recording(Path::new("somewhere/b.mcap")), None);
    }

    #[test]
    fn no_run_is_called_like_a_flag() {
        for (asked, called) in [("-x", "./-x"), ("--run", "./--run"), ("a/-x", "a/-x"), ("./-x", "./-x"), ("", "")] {
            assert_eq!(RunFolder::new(asked).root().as_os_str(), called);
        }
    }

    #[test]
    fn a_rollouts_name_is_read_as_it_was_made() {
        let kinds = [RolloutName::Manifest, RolloutName::Tensors, RolloutName::Figures, RolloutName::Folder];
        assert_eq!(
            kinds.map(|kind| kind.of(12)),
            ["rollout-00000012.json", "rollout-00000012.safetensors", "rollout-00000012.jsonl", "rollout-00000012"]
        );
        for kind in kinds {
            for rollout in [0, 12, 123_456_789] {
                let path = Path::new("runs/a").join(kind.of(rollout));
                let read = kinds.map(|other| other.rollout_of(&path));
                assert_eq!(read, kinds.map(|other| (other == kind).then_some(rollout)));
            }
        }
        for other in ["rollout-1.json.partial", "rollout-x.json", "best", "rollout-", ".json"] {
            assert_eq!(kinds.map(|kind| kind.rollout_of(Path::new(other))), [None; 4], "{other}");
        }
    }

    #[test]
    fn a_file_is_replaced_whole_and_leaves_no_temporary() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        write_atomically(&path, b"one").unwrap();
        write_atomically(&path, b"two").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"two");
        let other = folder.path().join("folder");
        std::fs::create_dir(&other).unwrap();
        assert!(write_atomically(&other, b"one").is_err());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
    }

    #[test]
    fn no_link_is_written_through() {
        let folder = tempfile::tempdir().unwrap();
        let [precious, path, partial] = ["precious", "a", "a.partial"].map(|name| folder.path().join(name));
        std::fs::write(&precious, "precious").unwrap();
        for link in [&path, &partial] {
            std::os::unix::fs::symlink(&precious, link).unwrap();
        }
        write_atomically(&path, b"one").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"one");
        assert!(!path.is_symlink() && !partial.is_symlink());
        assert_eq!(std::fs::read_to_string(&precious).unwrap(), "precious");
    }
}
