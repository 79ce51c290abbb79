//! Who works on a run folder: `orchestrator.lock`, and the locks of learners that outlive their orchestrator.

use super::identity::{Identity, host_name};
use crate::preflight::disk::NO_LOCKS;
use anyhow::{Context, Result, bail};
use proto::disk::is_not_offered;
use proto::plain_file::open_plain;
use proto::run_folder::RunFolder;
use proto::run_state::{Ending, RunState};
use serde::{Deserialize, Serialize};
use std::fmt::{Display, Formatter};
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read, Seek, Write};
use std::ops::Range;
use std::os::unix::fs::MetadataExt;
use std::time::{Duration, Instant};

/// Bytes that are read of a lock file. Ours have about a hundred; one that somebody put there can have any number.
const HOLDER_BYTES_MOST: u64 = 4096;

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Holder {
    pub pid: u32,
    pub host: String,
    pub incarnation: u32,
    /// The PID namespace that numbers its process. None in locks of versions that did not note it.
    pub pid_namespace: Option<u64>,
}

impl Holder {
    fn this_process(incarnation: u32) -> Self {
        let (pid, host, pid_namespace) = (std::process::id(), host_name(), pid_namespace());
        Self { pid, host, incarnation, pid_namespace }
    }

    /// Whether its process id means here what it means there. Containers have numbers of their own.
    pub fn is_here(&self) -> bool {
        self.host == host_name() && (self.pid_namespace.is_none() || self.pid_namespace == pid_namespace())
    }
}

impl Display for Holder {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        write!(f, "pid {} on {}", self.pid, self.host)?;
        let hidden = self.host == host_name() && !self.is_here();
        f.write_str(if hidden { ", in another container or PID namespace" } else { "" })
    }
}

/// What numbers the processes that this one can name: the inode of its PID namespace.
fn pid_namespace() -> Option<u64> {
    std::fs::metadata("/proc/self/ns/pid").ok().map(|namespace| namespace.ino())
}

/// The right to run a folder, until dropped. The kernel takes it back when the process dies, however it dies.
#[derive(Debug)]
pub struct RunLock {
    file: File,
}

impl RunLock {
    pub fn acquire_within(folder: &RunFolder, patience: Duration) -> Result<Self> {
        let began = Instant::now();
        loop {
            match Self::acquire(folder) {
                Err(_) if began.elapsed() < patience => std::thread::sleep(Duration::from_millis(200)),
                taken => return taken,
            }
        }
    }

    /// Takes the lock; the error names the holder. Waits a moment: `status` holds it shared for microseconds.
    pub fn acquire(folder: &RunFolder) -> Result<Self> {
        refuse_links(folder)?;
        let path = folder.orchestrator_lock();
        let file = open_plain(&path, OpenOptions::new().create(true).truncate(false).read(true).write(true))
            .with_context(|| format!("cannot open {}", path.display()))?;
        if wait_for_lock(&file, Duration::from_millis(500))? {
            // The last holder's signature: its process id may belong to another process by now, and `stop` would signal
            // that one.
            file.set_len(0).with_context(|| format!("cannot write {}", path.display()))?;
            return Ok(Self { file });
        }
        match holder_in(&file) {
            Some(holder) => bail!(
                "{} is already in use: {holder} runs it (`orchestrator status` shows how it stands, `orchestrator stop` \
                 ends it)",
                folder.root().display()
            ),
            None => bail!("{} is already in use by another orchestrator", folder.root().display()),
        }
    }

    pub fn sign(&mut self, incarnation: u32) -> Result<()> {
        let text = toml::to_string(&Holder::this_process(incarnation)).context("orchestrator.lock")?;
        self.file.set_len(0)?;
        self.file.rewind()?;
        self.file.write_all(text.as_bytes()).context("orchestrator.lock")
    }
}

/// Refuses a run whose own folders are links: what is written into them would go elsewhere. The run folder itself may be
/// one: the user names it.
fn refuse_links(folder: &RunFolder) -> Result<()> {
    let own = [folder.checkpoints(), folder.recordings(), folder.logs(), folder.scenes(), folder.validations()];
    let others = [folder.kitchens(), folder.tensorboard(), folder.hosts()];
    let hosts = folder.list(&folder.hosts()).unwrap_or_default().into_iter().map(|item| item.path);
    for path in own.into_iter().chain(others).chain(hosts) {
        if path.is_symlink() {
            bail!(
                "{} is a link, and a run writes into its own folder only: put a folder there. (To keep a run on another \
                 disk, let --run name a folder there.)",
                path.display()
            );
        }
    }
    Ok(())
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum LockState {
    Free,
    By(Holder),
    Unsigned,
}

pub fn holder(folder: &RunFolder) -> Result<LockState> {
    let path = folder.orchestrator_lock();
    let file = match folder.open(&path) {
        Ok(file) => file,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(LockState::Free),
        Err(error) => return Err(error).with_context(|| path.display().to_string()),
    };
    match file.try_lock_shared() {
        Ok(()) => Ok(LockState::Free),
        Err(TryLockError::WouldBlock) => Ok(holder_in(&file).map_or(LockState::Unsigned, LockState::By)),
        // Where nobody can hold a lock, nobody works: a run that was copied there can be looked at.
        Err(TryLockError::Error(error)) if is_not_offered(&error) => Ok(LockState::Free),
        Err(TryLockError::Error(error)) => Err(error).with_context(|| path.display().to_string()),
    }
}

fn holder_in(file: &File) -> Option<Holder> {
    let mut text = String::new();
    file.take(HOLDER_BYTES_MOST).read_to_string(&mut text).ok()?;
    toml::from_str(&text).ok()
}

/// Waits until all learners that outlived their orchestrator have released the folder: those of this configuration
/// and those of an older one. `tell` is called once, with the rank of the first that takes
/// more than a moment. Returns the rank of one that still holds its lock after `patience`.
pub fn wait_for_learners(
    folder: &RunFolder,
    learners: Range<u32>,
    patience: Duration,
    tell: impl FnOnce(u32),
) -> Result<Option<u32>> {
    let begin = Instant::now();
    let mut tell = Some(tell);
    for rank in (learners.start..).take_while(|&rank| rank < learners.end || folder.learner_lock(rank).exists()) {
        let path = folder.learner_lock(rank);
        let file = match open_plain(&path, OpenOptions::new().read(true).write(true)) {
            Ok(file) => file,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => continue,
            Err(error) => return Err(error).with_context(|| path.display().to_string()),
        };
        if wait_for_lock(&file, Duration::from_millis(200))? {
            continue;
        }
        if let Some(tell) = tell.take() {
            tell(rank);
        }
        if !wait_for_lock(&file, patience.saturating_sub(begin.elapsed()))? {
            return Ok(Some(rank));
        }
    }
    Ok(None)
}

/// Whether the lock was taken within this time.
pub fn wait_for_lock(file: &File, patience: Duration) -> Result<bool> {
    let begin = Instant::now();
    loop {
        match file.try_lock() {
            Ok(()) => return Ok(true),
            Err(TryLockError::WouldBlock) if begin.elapsed() >= patience => return Ok(false),
            // The kernel wakes for a released lock only those who wait without a deadline.
            Err(TryLockError::WouldBlock) => std::thread::sleep(Duration::from_millis(20)),
            Err(TryLockError::Error(error)) => {
                let what = if is_not_offered(&error) { NO_LOCKS } else { "file lock" };
                return Err(error).context(what);
            }
        }
    }
}

/// The state of a run with this lock. `complete`: its result is there, whatever its last session noted.
pub fn state_of(identity: &Identity, held: &LockState, complete: bool) -> RunState {
    match (held, identity.incarnations.last()) {
        (LockState::By(_) | LockState::Unsigned, _) => RunState::Running,
        (LockState::Free, _) if complete => RunState::Ended(Ending::Complete),
        (LockState::Free, None) => RunState::NotStarted,
        (LockState::Free, Some(last)) => {
            last.ended.as_ref().map_or(RunState::CutOff, |ended| RunState::Ended(ended.how))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::identity::tests::{ended, folder};
    use super::*;

    #[test]
    fn a_process_id_of_another_namespace_or_host_means_nothing_here() {
        let here = Holder::this_process(1);
        let contained = Holder { pid_namespace: Some(1), ..here.clone() };
        let elsewhere = Holder { host: "elsewhere".to_owned(), ..here.clone() };
        let older = Holder { pid_namespace: None, ..here.clone() };
        assert_eq!([&here, &older, &contained, &elsewhere].map(Holder::is_here), [true, true, false, false]);
        assert!(contained.to_string().ends_with(", in another container or PID namespace"), "{contained}");
        assert_eq!(elsewhere.to_string(), format!("pid {} on elsewhere", std::process::id()));
    }

    #[test]
    fn a_lock_that_is_a_link_is_refused() {
        let (_temporary, folder) = folder();
        let precious = folder.root().join("precious");
        std::fs::write(&precious, "precious").unwrap();
        std::os::unix::fs::symlink(&precious, folder.orchestrator_lock()).unwrap();
        let message = format!("{:#}", RunLock::acquire(&folder).unwrap_err());
        assert!(message.contains("orchestrator.lock") && message.contains("a link"), "{message}");
        assert!(holder(&folder).is_err());
        assert_eq!(std::fs::read_to_string(&precious).unwrap(), "precious");
    }

    #[test]
    fn a_run_whose_folders_are_links_is_refused() {
        let (_temporary, folder) = folder();
        let elsewhere = tempfile::tempdir().unwrap();
        let own = [folder.checkpoints(), folder.recordings(), folder.logs(), folder.scenes(), folder.validations()];
        std::fs::create_dir(folder.hosts()).unwrap();
        let others = [folder.kitchens(), folder.tensorboard(), folder.host(1).root().to_path_buf()];
        for path in own.into_iter().chain(others) {
            std::os::unix::fs::symlink(elsewhere.path(), &path).unwrap();
            let message = RunLock::acquire(&folder).unwrap_err().to_string();
            assert!(message.contains(&format!("{} is a link", path.display())), "{message}");
            std::fs::remove_file(&path).unwrap();
        }
        std::fs::remove_dir(folder.hosts()).unwrap();
        std::os::unix::fs::symlink(elsewhere.path(), folder.hosts()).unwrap();
        assert!(RunLock::acquire(&folder).unwrap_err().to_string().contains("hosts is a link"));
        std::fs::remove_file(folder.hosts()).unwrap();
        assert!(!folder.orchestrator_lock().exists());
        // The run folder itself may be reached by one.
        let link = elsewhere.path().join("latest");
        std::os::unix::fs::symlink(folder.root(), &link).unwrap();
        RunLock::acquire(&RunFolder::new(&link)).unwrap();
    }

    #[test]
    fn every_learner_is_waited_for() {
        let (_temporary, folder) = folder();
        let patience = Duration::from_millis(50);
        let wait = |learners| {
            let mut told = None;
            let holds = wait_for_learners(&folder, 0..learners, patience, |rank| told = Some(rank)).unwrap();
            assert_eq!(told, holds, "who holds on is told of");
            holds
        };
        assert_eq!(wait(3), None, "a run that was never started");
        let locks: Vec<File> = (0..3).map(|rank| File::create(folder.learner_lock(rank)).unwrap()).collect();
        assert_eq!(wait(3), None);
        locks[2].try_lock().unwrap();
        assert_eq!(wait(3), Some(2));
        assert_eq!(wait(1), Some(2), "there were more before");
    }

    #[test]
    fn who_holds_a_run_comes_first_then_its_result_then_its_last_word() {
        let mut identity = Identity::new().unwrap();
        let state = |identity: &Identity, held, complete| state_of(identity, &held, complete).to_string();
        assert_eq!(state(&identity, LockState::Free, false), "not started");
        identity.begin_incarnation();
        assert_eq!(state(&identity, LockState::Unsigned, false), "running");
        assert_eq!(state(&identity, LockState::Free, false), "cut off");
        for (how, word) in [
            (Ending::Complete, "complete"),
            (Ending::Stopped, "stopped"),
            (Ending::Interrupted, "interrupted"),
            (Ending::Failed, "failed"),
        ] {
            identity.end_incarnation(ended(how, 1));
            assert_eq!(state(&identity, LockState::Free, false), word);
        }
        assert_eq!(state(&identity, LockState::Free, true), "complete");
    }
}
