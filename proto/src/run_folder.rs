//! Layout of a run folder. Every path in it is made here.
//!
//! ```text
//! RUN/
//!   run.toml               identity of the run: id, schema version, incarnations so far
//!   config.toml            effective configuration; only `resume` with another budget or shape and `scale` replace it
//!   task.toml              the task's declaration: channels, actions, rewards, metrics
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
//!   best -> validation/rollout-00000012   the best checkpoint so far; a file with this text where there are no links
//!   evaluations/           what `orchestrator eval RUN` made
//!   nonfinite-rollout-12.safetensors   the batch of an update that met a number that is not finite
//!   summary.json           written when the budget is reached
//! ```

use crate::bounded;
use crate::disk::{Disk, LocalDisk};
use crate::fault;
use crate::plain_file::{open_below, open_folder_below};
use rustix::fs::{AtFlags, FileType};
use serde::Deserialize;
use std::cmp::Ordering;
use std::ffi::OsStr;
use std::fs::File;
use std::io::{BufReader, Error, ErrorKind, Result, Take};
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

/// The same path, as `./-x` where it begins with a dash: no program that is given it takes it for a flag.
pub fn unlike_a_flag(path: impl Into<PathBuf>) -> PathBuf {
    let path = path.into();
    if path.as_os_str().as_encoded_bytes().starts_with(b"-") { Path::new(".").join(path) } else { path }
}

/// A run folder, existing or about to be created. It may be somebody else's: what is in it is read by its methods.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RunFolder {
    root: PathBuf,
    /// What of the root the user named. On the way there links are followed, and none below it.
    named: PathBuf,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Item {
    /// Its path, with the folder's.
    pub path: PathBuf,
    /// A folder, not a link to one.
    pub is_folder: bool,
    /// Size, if it is a file.
    pub bytes: u64,
}

impl RunFolder {
    pub fn new(root: impl Into<PathBuf>) -> Self {
        let root = unlike_a_flag(root);
        Self { named: root.clone(), root }
    }

    pub fn root(&self) -> &Path {
        &self.root
    }

    /// A folder in it, in the same layout: an evaluation's, another host's.
    #[must_use]
    pub fn within(&self, below: impl AsRef<Path>) -> Self {
        Self { root: self.root.join(below), named: self.named.clone() }
    }

    fn below<'a>(&self, path: &'a Path) -> Result<&'a Path> {
        let outside = |_| Error::new(ErrorKind::InvalidInput, "it does not lie in the run folder");
        path.strip_prefix(&self.named).map_err(outside)
    }

    /// Opens a plain file in it for reading. No link is followed.
    pub fn open(&self, path: &Path) -> Result<File> {
        open_below(&self.named, self.below(path)?)
    }

    pub fn has(&self, path: &Path) -> bool {
        self.open(path).is_ok()
    }

    /// The bytes of a file in it that has `most` at most.
    pub fn read(&self, path: &Path, most: u64) -> Result<Vec<u8>> {
        bounded::content(self.open(path)?, most)
    }

    /// The text of a file in it, of 4 MiB at most.
    pub fn read_text(&self, path: &Path) -> Result<String> {
        bounded::text(self.read(path, bounded::TEXT_BYTES_MOST)?)
    }

    /// A file in it that has `most` bytes at most, to be read piece by piece.
    pub fn reader(&self, path: &Path, most: u64) -> Result<BufReader<Take<File>>> {
        bounded::reader(self.open(path)?, most)
    }

    /// What is in a folder of it, 100,000 files at most, by number. A folder that is not there holds nothing. A link
    /// counts as a file, which [`RunFolder::open`] refuses.
    pub fn list(&self, folder: &Path) -> Result<Vec<Item>> {
        let opened = match open_folder_below(&self.named, self.below(folder)?) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
            opened => opened?,
        };
        let mut items = Vec::new();
        for entry in rustix::fs::Dir::read_from(&opened)? {
            let entry = entry?;
            let name = OsStr::from_bytes(entry.file_name().to_bytes());
            if name == "." || name == ".." {
                continue;
            }
            // One that was removed meanwhile is not there.
            let Ok(stat) = rustix::fs::statat(&opened, name, AtFlags::SYMLINK_NOFOLLOW) else { continue };
            let is_folder = FileType::from_raw_mode(stat.st_mode) == FileType::Directory;
            if items.len() == bounded::ENTRIES_MOST {
                return Err(bounded::too_long(&format!("{} files", bounded::ENTRIES_MOST)));
            }
            items.push(Item { path: folder.join(name), is_folder, bytes: stat.st_size as u64 });
        }
        items.sort_by(|a, b| by_number(&a.path, &b.path));
        Ok(items)
    }

    pub fn identity(&self) -> PathBuf {
        self.root.join("run.toml")
    }

    /// The id in `run.toml`; none where there is none that can be read.
    pub fn id(&self) -> Option<String> {
        #[derive(Deserialize)]
        struct Named {
            id: String,
        }
        let text = self.read_text(&self.identity()).ok()?;
        toml::from_str(&text).ok().map(|Named { id }| id)
    }

    pub fn config(&self) -> PathBuf {
        self.root.join("config.toml")
    }

    pub fn task(&self) -> PathBuf {
        self.root.join("task.toml")
    }

    /// Another number of actors that is asked for.
    pub fn scale_request(&self) -> PathBuf {
        self.root.join("scale.toml")
    }

    pub fn orchestrator_lock(&self) -> PathBuf {
        self.root.join("orchestrator.lock")
    }

    /// Lock of a learner: only its holder may write checkpoints.
    pub fn learner_lock(&self, rank: u32) -> PathBuf {
        self.root.join(format!("learner-{rank}.lock"))
    }

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

    pub fn scenes(&self) -> PathBuf {
        self.root.join("scenes")
    }

    pub fn scene(&self, index: usize) -> PathBuf {
        self.root.join(self.relative_scene(index))
    }

    /// The same, relative to the folder: what the effective configuration names.
    pub fn relative_scene(&self, index: usize) -> String {
        format!("scenes/{index:03}")
    }

    pub fn kitchens(&self) -> PathBuf {
        self.root.join("kitchens")
    }

    /// The run folder of a recording, if the recording is where [`RunFolder::recording`] puts it.
    pub fn of_recording(recording: &Path) -> Option<Self> {
        let recordings = recording.parent()?;
        let root = recordings.parent()?;
        (recordings.file_name()? == "recordings").then(|| Self::new(root))
    }

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
        self.within(format!("hosts/{host:03}"))
    }

    /// The folders of other hosts that are here, in order, [`HOSTS_MOST`] at most.
    pub fn host_folders(&self) -> Vec<Self> {
        let is_hosts = |item: &Item| {
            let name = item.path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
            item.is_folder && name.parse::<u32>().is_ok()
        };
        let folders = self.list(&self.hosts()).unwrap_or_default().into_iter().filter(is_hosts).take(HOSTS_MOST);
        folders.map(|item| Self { root: item.path, named: self.named.clone() }).collect()
    }

    /// Folder of the other hosts' folders.
    pub fn hosts(&self) -> PathBuf {
        self.root.join("hosts")
    }

    pub fn logs(&self) -> PathBuf {
        self.root.join("logs")
    }

    pub fn log(&self, process: &str) -> PathBuf {
        self.logs().join(format!("{process}.log"))
    }

    /// What an actor whose environments are not built in keeps written down ([`crate::actor_notes`]).
    pub fn actor_notes(&self, actor: u32) -> PathBuf {
        self.logs().join(format!("actor-{actor:02}.at"))
    }

    /// One line a trained rollout.
    pub fn metrics(&self) -> PathBuf {
        self.root.join("metrics.jsonl")
    }

    pub fn tensorboard(&self) -> PathBuf {
        self.root.join("tensorboard")
    }

    /// One line an evaluation made while it trained.
    pub fn validation_log(&self) -> PathBuf {
        self.root.join("validation.jsonl")
    }

    pub fn validations(&self) -> PathBuf {
        self.root.join("validation")
    }

    /// The one of the checkpoint whose first missing rollout is `rollout`.
    pub fn validation(&self, rollout: u64) -> PathBuf {
        self.root.join(Self::relative_validation(rollout))
    }

    /// The same, relative to the folder: what [`RunFolder::best`] names.
    pub fn relative_validation(rollout: u64) -> String {
        format!("validation/{}", RolloutName::Folder.of(rollout))
    }

    /// The best checkpoint so far by validation: a symbolic link to its folder, or a file with the link's text where the
    /// disk has no links.
    pub fn best(&self) -> PathBuf {
        self.root.join(BEST)
    }

    /// The rollout of the best checkpoint so far, as [`Self::best`] names it. Names of anything but a validation of the
    /// run's own do not count.
    pub fn best_rollout(&self) -> Option<u64> {
        let path = self.best();
        let named = std::fs::read_link(&path).or_else(|_| bounded::read_text(&path).map(|text| text.trim_end().into()));
        let named = named.ok()?;
        let rollout = RolloutName::Folder.rollout_of(&named)?;
        (named == Path::new(&Self::relative_validation(rollout))).then_some(rollout)
    }

    /// Names the best checkpoint. At every moment there is one, the old or the new.
    pub fn set_best(&self, rollout: u64) -> std::io::Result<()> {
        let (path, target) = (self.best(), Self::relative_validation(rollout));
        let partial = path.with_extension("partial");
        match std::fs::remove_file(&partial) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        let linked = std::os::unix::fs::symlink(&target, &partial).and_then(|()| {
            fault::reach("validation.before_crown");
            std::fs::rename(&partial, &path)
        });
        // exFAT, network disks and shared folders of virtual machines have no links.
        linked.or_else(|_| write_atomically(&path, format!("{target}\n").as_bytes()))
    }

    /// The folder that a file called `best` names, as [`Self::set_best`] writes it; `path` itself where it is none.
    pub fn through_best(path: PathBuf) -> PathBuf {
        let run = path.parent().filter(|_| path.file_name() == Some(BEST.as_ref()) && path.is_file()).map(Self::new);
        run.and_then(|run| Some(run.validation(run.best_rollout()?))).unwrap_or(path)
    }

    /// The batch of rollout `rollout`, whose update met a number that is not finite: the part of one learner.
    pub fn nonfinite_dump(&self, rollout: u64, rank: u32) -> PathBuf {
        let learner = if rank > 0 { format!("-learner-{rank}") } else { String::new() };
        self.root.join(format!("nonfinite-rollout-{rollout}{learner}.safetensors"))
    }

    pub fn summary(&self) -> PathBuf {
        self.root.join("summary.json")
    }
}

const HOSTS_MOST: usize = 1024;

/// Orders paths by the numbers in them: the 999th recording comes before the 1000th.
pub fn by_number(a: &Path, b: &Path) -> Ordering {
    let parts = |path: &Path| -> Vec<(usize, Vec<u8>)> {
        let bytes = path.as_os_str().as_encoded_bytes();
        let parts = bytes.chunk_by(|a, b| a.is_ascii_digit() == b.is_ascii_digit());
        // A number is the greater the more digits it has, zeros before it left out.
        let part = |part: &[u8]| match part.iter().position(|&byte| byte != b'0') {
            _ if !part[0].is_ascii_digit() => (0, part.to_vec()),
            from => (1 + part.len() - from.unwrap_or(part.len()), part[from.unwrap_or(part.len())..].to_vec()),
        };
        parts.map(part).collect()
    };
    parts(a).cmp(&parts(b)).then_with(|| a.cmp(b))
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

const PREFIX: &str = "rollout-";

pub const BEST: &str = "best";

/// What the name of a file ends in while [`write_atomically`] writes it.
pub const PARTIAL: &str = ".partial";

/// Writes a file so that a reader finds either the old content or the new, whole: temporary file in the same folder,
/// fsync, rename, fsync of the folder.
pub fn write_atomically(path: &Path, content: &[u8]) -> Result<()> {
    write_pieces_atomically_on(&LocalDisk, path, std::iter::once(content))
}

/// The same on any file system, of a content that is not in memory as a whole.
pub fn write_pieces_atomically_on<D: Disk, B: AsRef<[u8]>>(
    disk: &D,
    path: &Path,
    mut pieces: impl Iterator<Item = B>,
) -> Result<()> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut temporary = path.as_os_str().to_owned();
    temporary.push(PARTIAL);
    let temporary = PathBuf::from(temporary);
    fault::reach("file.before_write");
    // One that a crash left gives way. Made anew, it cannot be a link to a file elsewhere.
    match disk.remove(&temporary) {
        Err(error) if error.kind() != ErrorKind::NotFound => return Err(error),
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
    fn what_is_in_it_is_listed_by_number_and_no_link_is_followed() {
        let temporary = tempfile::tempdir().unwrap();
        let run = RunFolder::new(temporary.path());
        assert_eq!(run.list(&run.recordings()).unwrap(), [], "there is no such folder");
        std::fs::create_dir(run.recordings()).unwrap();
        for (incarnation, segment) in [(1, 1000), (1, 999), (10, 0), (9, 10_000), (1000, 0), (999, 7)] {
            std::fs::write(run.recording(incarnation, segment), "four").unwrap();
        }
        let listed: Vec<PathBuf> = run.list(&run.recordings()).unwrap().into_iter().map(|item| item.path).collect();
        let sorted = [(1, 999), (1, 1000), (9, 10_000), (10, 0), (999, 7), (1000, 0)];
        assert_eq!(listed, sorted.map(|(incarnation, segment)| run.recording(incarnation, segment)));
        for number in [0, 7, 999, 1000, 80] {
            std::fs::create_dir_all(run.host(number).root()).unwrap();
        }
        assert_eq!(run.host_folders(), [0, 7, 80, 999, 1000].map(|number| run.host(number)));
        let (linked, elsewhere) = (run.logs(), tempfile::tempdir().unwrap());
        std::fs::write(elsewhere.path().join("orchestrator.log"), "private").unwrap();
        std::os::unix::fs::symlink(elsewhere.path(), &linked).unwrap();
        assert!(run.list(&linked).is_err() && !run.has(&run.log("orchestrator")));
        assert!(!run.has(&elsewhere.path().join("orchestrator.log")), "it does not lie in the folder");
    }

    #[test]
    fn the_best_is_named_by_a_link_or_by_a_file_and_is_of_the_run_itself() {
        let temporary = tempfile::tempdir().unwrap();
        let run = RunFolder::new(temporary.path());
        assert_eq!(run.best_rollout(), None);
        let through = || RunFolder::through_best(run.best());
        for rollout in [3, 12] {
            run.set_best(rollout).unwrap();
            assert!(run.best().is_symlink() && run.best_rollout() == Some(rollout));
            assert_eq!(through(), run.best(), "a link leads there by itself");
        }
        std::fs::remove_file(run.best()).unwrap();
        for (text, rollout) in [
            ("validation/rollout-00000003\n", Some(3)),
            ("validation/rollout-00000012", Some(12)),
            ("/etc/rollout-00000012", None),
            ("validation/../rollout-00000012", None),
            ("checkpoints", None),
            ("", None),
        ] {
            std::fs::write(run.best(), text).unwrap();
            assert_eq!(run.best_rollout(), rollout, "{text}");
            assert_eq!(through(), rollout.map_or(run.best(), |rollout| run.validation(rollout)), "{text}");
        }
        run.set_best(4).unwrap();
        assert!(run.best().is_symlink() && run.best_rollout() == Some(4), "a link takes the file's place");
        std::fs::remove_file(run.best()).unwrap();
        std::fs::create_dir(run.best()).unwrap();
        assert!(run.set_best(5).is_err());
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
