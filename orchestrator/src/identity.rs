//! Who a run is (`run.toml`, `config.toml`) and who runs it (`orchestrator.lock`).

use anyhow::{Context, Result, bail};
use proto::SCHEMA_VERSION;
use proto::config::Config;
use proto::run_folder::{RunFolder, write_atomically};
use serde::{Deserialize, Serialize};
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read, Seek, Write};
use std::path::Path;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use wire::WireAddress;

/// `run.toml`: what a run is called and what has become of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Identity {
    /// Version of everything in the folder.
    pub schema_version: u32,
    /// 12 hex digits; part of every name in shared memory.
    pub id: String,
    /// Version of the program that created it.
    pub created_by: String,
    /// When, seconds since 1970.
    pub created_unix_s: u64,
    /// Every start of an orchestrator on it, oldest first.
    #[serde(default)]
    pub incarnations: Vec<Incarnation>,
}

/// One start of an orchestrator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Incarnation {
    /// From 1.
    pub number: u32,
    /// Address of its services.
    pub wire: String,
    /// Machine it ran on.
    pub host: String,
    /// Its process.
    pub pid: u32,
    /// When it began, seconds since 1970.
    pub started_unix_s: u64,
    /// How it ended; absent while it runs and after a crash.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ended: Option<Ended>,
}

/// How an incarnation ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Ended {
    /// `complete`, `stopped`, `interrupted` or `failed`.
    pub how: String,
    /// When, seconds since 1970.
    pub at_unix_s: u64,
    /// Frames trained on in the state that was saved last, if that is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frames: Option<u64>,
    /// SHA-256 of the weights saved last, if that is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub weights: Option<String>,
    /// Why it failed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
}

impl Identity {
    /// A new identity.
    pub fn new() -> Result<Self> {
        let mut bytes = [0u8; 6];
        File::open("/dev/urandom").and_then(|mut source| source.read_exact(&mut bytes)).context("/dev/urandom")?;
        Ok(Self {
            schema_version: SCHEMA_VERSION,
            id: format!("{:012x}", bytes.iter().fold(0u64, |id, &byte| id << 8 | u64::from(byte))),
            created_by: env!("CARGO_PKG_VERSION").to_owned(),
            created_unix_s: unix_now(),
            incarnations: Vec::new(),
        })
    }

    /// Reads `run.toml` of an existing run.
    pub fn read(folder: &RunFolder) -> Result<Self> {
        let path = folder.identity();
        let root = folder.root().display();
        let text = match std::fs::read_to_string(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                bail!("{root} is not a run folder: it has no run.toml")
            }
            Err(error) => return Err(error).with_context(|| path.display().to_string()),
        };
        let identity: Self = toml::from_str(&text).with_context(|| format!("{} is damaged", path.display()))?;
        if identity.schema_version != SCHEMA_VERSION {
            bail!(
                "{root} was written by version {} with schema {}; this program reads schema {SCHEMA_VERSION}",
                identity.created_by,
                identity.schema_version
            );
        }
        Ok(identity)
    }

    /// Writes `run.toml`, atomically.
    pub fn write(&self, folder: &RunFolder) -> Result<()> {
        let text = toml::to_string(self).context("run.toml")?;
        write_atomically(&folder.identity(), text.as_bytes())
            .with_context(|| format!("cannot write {}", folder.identity().display()))
    }

    /// Adds the next incarnation and returns its address.
    pub fn begin_incarnation(&mut self) -> (u32, WireAddress) {
        let number = self.incarnations.last().map_or(0, |last| last.number) + 1;
        let address = WireAddress::new(&self.id, number);
        self.incarnations.push(Incarnation {
            number,
            wire: address.to_string(),
            host: host_name(),
            pid: std::process::id(),
            started_unix_s: unix_now(),
            ended: None,
        });
        (number, address)
    }

    /// Notes how the last incarnation ended.
    pub fn end_incarnation(&mut self, ended: Ended) {
        if let Some(last) = self.incarnations.last_mut() {
            last.ended = Some(ended);
        }
    }
}

/// Whether a folder holds an evaluation: one that was cut off is made anew, not gone on with.
pub fn is_evaluation(folder: &RunFolder) -> bool {
    Config::of_run(folder).is_ok_and(|config| config.evaluation.is_some())
}

/// Seconds since 1970.
pub fn unix_now() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| time.as_secs())
}

/// Name of this machine.
pub fn host_name() -> String {
    rustix::system::uname().nodename().to_string_lossy().into_owned()
}

/// Who holds a run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Holder {
    /// Process id of the orchestrator.
    pub pid: u32,
    /// Machine it runs on.
    pub host: String,
    /// Incarnation of the run.
    pub incarnation: u32,
}

/// The right to run a folder, until dropped. The kernel takes it back when the process dies, however it dies.
#[derive(Debug)]
pub struct RunLock {
    file: File,
}

impl RunLock {
    /// Takes the lock, or says who holds it. Waits a moment: `status` holds it shared for microseconds.
    pub fn acquire(folder: &RunFolder) -> Result<Self> {
        let path = folder.orchestrator_lock();
        let file = OpenOptions::new()
            .create(true)
            .truncate(false)
            .read(true)
            .write(true)
            .open(&path)
            .with_context(|| format!("cannot open {}", path.display()))?;
        if wait_for_lock(&file, Duration::from_millis(500))? {
            // The last holder's signature: its process id may be somebody else's by now, and `stop` would signal it.
            file.set_len(0).with_context(|| format!("cannot write {}", path.display()))?;
            return Ok(Self { file });
        }
        match holder_in(&path) {
            Some(holder) => bail!(
                "{} is already in use: pid {} on {} runs it (`orchestrator status` shows how it stands, \
                 `orchestrator stop` ends it)",
                folder.root().display(),
                holder.pid,
                holder.host
            ),
            None => bail!("{} is already in use by another orchestrator", folder.root().display()),
        }
    }

    /// Writes down who holds it, for `stop` and `status`.
    pub fn sign(&mut self, incarnation: u32) -> Result<()> {
        let holder = Holder { pid: std::process::id(), host: host_name(), incarnation };
        let text = toml::to_string(&holder).context("orchestrator.lock")?;
        self.file.set_len(0)?;
        self.file.rewind()?;
        self.file.write_all(text.as_bytes()).context("orchestrator.lock")
    }
}

/// Whether someone holds a run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Held {
    /// Nobody.
    Free,
    /// This one.
    By(Holder),
    /// Someone who has not signed yet.
    Unsigned,
}

/// Who holds the run in `folder` now.
pub fn holder(folder: &RunFolder) -> Result<Held> {
    let path = folder.orchestrator_lock();
    let file = match File::open(&path) {
        Ok(file) => file,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Held::Free),
        Err(error) => return Err(error).with_context(|| path.display().to_string()),
    };
    match file.try_lock_shared() {
        Ok(()) => Ok(Held::Free),
        Err(TryLockError::WouldBlock) => Ok(holder_in(&path).map_or(Held::Unsigned, Held::By)),
        Err(TryLockError::Error(error)) => Err(error).with_context(|| path.display().to_string()),
    }
}

/// How a run stands: `running`, `complete`, `stopped`, `interrupted`, `failed` or `cut off`.
pub fn state(identity: &Identity, held: &Held, complete: bool) -> String {
    match (held, identity.incarnations.last().and_then(|last| last.ended.as_ref())) {
        (Held::By(_) | Held::Unsigned, _) => "running".to_owned(),
        (Held::Free, _) if complete => "complete".to_owned(),
        (Held::Free, Some(ended)) => ended.how.clone(),
        (Held::Free, None) => "cut off".to_owned(),
    }
}

fn holder_in(path: &Path) -> Option<Holder> {
    toml::from_str(&std::fs::read_to_string(path).ok()?).ok()
}

/// Waits until all learners that outlived their orchestrator have let go of the folder: those that there are to be, and
/// those that there were under an older configuration. `tell` is called once, with the rank of the first that takes more
/// than a moment. The rank of one that still holds on after `patience`.
pub fn wait_for_learners(
    folder: &RunFolder,
    learners: u32,
    patience: Duration,
    tell: impl FnOnce(u32),
) -> Result<Option<u32>> {
    let begin = Instant::now();
    let mut tell = Some(tell);
    for rank in (0..).take_while(|&rank| rank < learners || folder.learner_lock(rank).exists()) {
        let path = folder.learner_lock(rank);
        let file = match OpenOptions::new().read(true).write(true).open(&path) {
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

fn wait_for_lock(file: &File, patience: Duration) -> Result<bool> {
    let begin = Instant::now();
    loop {
        match file.try_lock() {
            Ok(()) => return Ok(true),
            Err(TryLockError::WouldBlock) if begin.elapsed() >= patience => return Ok(false),
            // Of a lock that is let go the kernel tells only who waits for it without a deadline.
            Err(TryLockError::WouldBlock) => std::thread::sleep(Duration::from_millis(20)),
            Err(TryLockError::Error(error)) => return Err(error).context("file lock"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder() -> (tempfile::TempDir, RunFolder) {
        let temporary = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(temporary.path());
        (temporary, folder)
    }

    #[test]
    fn a_folder_is_held_by_one_and_names_the_holder() {
        let (_temporary, folder) = folder();
        assert_eq!(holder(&folder).unwrap(), Held::Free);
        let mut lock = RunLock::acquire(&folder).unwrap();
        assert_eq!(holder(&folder).unwrap(), Held::Unsigned);
        lock.sign(3).unwrap();
        let expected = Holder { pid: std::process::id(), host: host_name(), incarnation: 3 };
        assert_eq!(holder(&folder).unwrap(), Held::By(expected));
        let message = RunLock::acquire(&folder).unwrap_err().to_string();
        assert!(message.contains("already in use: pid"), "{message}");
        drop(lock);
        assert_eq!(holder(&folder).unwrap(), Held::Free);
        let _unsigned = RunLock::acquire(&folder).unwrap();
        assert_eq!(holder(&folder).unwrap(), Held::Unsigned, "the signature of the holder before");
    }

    #[test]
    fn every_learner_is_waited_for() {
        let (_temporary, folder) = folder();
        let patience = Duration::from_millis(50);
        let wait = |learners| {
            let mut told = None;
            let holds = wait_for_learners(&folder, learners, patience, |rank| told = Some(rank)).unwrap();
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
    fn incarnations_count_up_and_never_share_an_address() {
        let (_temporary, folder) = folder();
        let mut identity = Identity::new().unwrap();
        assert_eq!(identity.id.len(), 12);
        let (first, first_address) = identity.begin_incarnation();
        identity.write(&folder).unwrap();
        let mut again = Identity::read(&folder).unwrap();
        assert_eq!(again, identity);
        let (second, second_address) = again.begin_incarnation();
        assert_eq!((first, second), (1, 2));
        assert_ne!(first_address, second_address);
        again.end_incarnation(Ended {
            how: "stopped".into(),
            at_unix_s: 5,
            frames: Some(7),
            weights: None,
            reason: None,
        });
        again.write(&folder).unwrap();
        assert_eq!(Identity::read(&folder).unwrap(), again);
    }

    #[test]
    fn what_is_no_run_folder_or_of_another_schema_is_refused() {
        let (_temporary, folder) = folder();
        assert!(Identity::read(&folder).unwrap_err().to_string().contains("not a run folder"));
        let identity = Identity { schema_version: SCHEMA_VERSION + 1, ..Identity::new().unwrap() };
        identity.write(&folder).unwrap();
        assert!(Identity::read(&folder).unwrap_err().to_string().contains("schema"));
    }
}
