//! Remains of dead incarnations: names in /dev/shm, a folder of small files, perhaps a hanging process.
//!
//! An orchestrator claims its names by holding a lock on `/dev/shm/PREFIXowner` for as long as it lives. The kernel
//! releases the lock when the process dies: a free lock means a dead owner, even if another process has its id by now.
//! The file is in /dev/shm, so it is found under any TMPDIR.
//!
//! Anybody can write to /dev/shm, and a run folder can come from anybody. So no file names what is deleted: an address
//! is made from the run's id and the number of the start alone.

use super::signal::open_process;
use crate::preflight::temporary;
use crate::process_end::sleep_until_end;
use anyhow::{Context, Result, bail};
use proto::plain_file::open_plain;
use rustix::process::{Pid, geteuid};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions, Permissions, TryLockError};
use std::io::{Read, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};
use wire::{SHARED_MEMORY, WireAddress, temporary_folder};

/// An owner file is locked and signed within this time of its creation; a younger one without an owner is left alone.
const CLAIMING: Duration = Duration::from_secs(10);
const KILLED_ENDS: Duration = Duration::from_secs(5);

pub struct Claim {
    _file: File,
}

#[derive(Debug, Serialize, Deserialize)]
struct Signature {
    run: PathBuf,
    pid: u32,
}

/// Claims the names at `address` for the run in `run`. To be done before anything else is created there.
pub fn claim(address: &WireAddress, run: &Path) -> Result<Claim> {
    let path = owner_file(address);
    let mut file = OpenOptions::new()
        .create_new(true)
        .write(true)
        .mode(0o600)
        .open(&path)
        .with_context(|| format!("cannot create {}", path.display()))?;
    // The umask may have taken from the mode.
    file.set_permissions(Permissions::from_mode(0o600)).with_context(|| path.display().to_string())?;
    file.try_lock().map_err(std::io::Error::from).with_context(|| format!("cannot lock {}", path.display()))?;
    let signature = Signature { run: run.to_path_buf(), pid: std::process::id() };
    file.write_all(serde_json::to_string(&signature)?.as_bytes())
        .with_context(|| format!("cannot write {}; is /dev/shm full?", path.display()))?;
    Ok(Claim { _file: file })
}

fn owner_file(address: &WireAddress) -> PathBuf {
    Path::new(SHARED_MEMORY).join(format!("{}owner", address.prefix()))
}

/// The owner file of an address, if this user made it. Another user's file is ignored.
fn open_owner(address: &WireAddress) -> Option<File> {
    let file = open_plain(&owner_file(address), OpenOptions::new().read(true)).ok()?;
    file.metadata().is_ok_and(|metadata| metadata.uid() == geteuid().as_raw()).then_some(file)
}

fn is_locked(owner: &File) -> bool {
    matches!(owner.try_lock_shared(), Err(TryLockError::WouldBlock))
}

pub struct Remains {
    pub address: WireAddress,
    pub run: Option<PathBuf>,
    pub names: usize,
    pub bytes: u64,
    /// True while its orchestrator lives (or someone is just starting there).
    pub alive: bool,
}

pub fn survey() -> Result<Vec<Remains>> {
    temporary::check().demand()?;
    let me = geteuid().as_raw();
    let mut found: BTreeMap<String, Names> = BTreeMap::new();
    for entry in std::fs::read_dir(SHARED_MEMORY).context(SHARED_MEMORY)? {
        let entry = entry?;
        let address = WireAddress::of_name(&entry.file_name().to_string_lossy());
        let (Some(address), Ok(metadata)) = (address, entry.metadata()) else { continue };
        if metadata.uid() == me && metadata.is_file() {
            let names = found.entry(address.prefix().to_owned()).or_insert_with(|| Names::none(address));
            names.count += 1;
            names.bytes += metadata.blocks() * 512;
            names.changed = names.changed.max(metadata.modified().unwrap_or(SystemTime::UNIX_EPOCH));
        }
    }
    let temporary = temporary_folder();
    for entry in std::fs::read_dir(&temporary).with_context(|| temporary.display().to_string())?.flatten() {
        let name = format!("{}_", entry.file_name().to_string_lossy());
        if let (Some(address), Ok(metadata)) = (WireAddress::of_name(&name), entry.metadata())
            && address.prefix() == name
            && metadata.uid() == me
            && metadata.is_dir()
        {
            let changed = metadata.modified().unwrap_or(SystemTime::UNIX_EPOCH);
            found.entry(name).or_insert_with(|| Names { changed, ..Names::none(address) });
        }
    }
    Ok(found.into_values().map(examine).collect())
}

struct Names {
    address: WireAddress,
    count: usize,
    bytes: u64,
    changed: SystemTime,
}

impl Names {
    fn none(address: WireAddress) -> Self {
        Self { address, count: 0, bytes: 0, changed: SystemTime::UNIX_EPOCH }
    }
}

fn examine(Names { address, count, bytes, changed }: Names) -> Remains {
    let mut owner = open_owner(&address);
    let mut text = String::new();
    let read = owner.as_mut().is_some_and(|file| file.read_to_string(&mut text).is_ok());
    let signature: Option<Signature> = serde_json::from_str(&text).ok().filter(|_| read);
    let locked = owner.is_some_and(|file| is_locked(&file));
    let young = changed.elapsed().is_ok_and(|age| age < CLAIMING);
    // Without an owner's signature (another program's services, a test's) use is what shows life.
    let alive = locked || (signature.is_none() && (young || is_mapped(address.prefix())));
    Remains { address, run: signature.map(|signature| signature.run), names: count, bytes, alive }
}

pub fn processes_of(address: &WireAddress) -> Vec<u32> {
    let Ok(entries) = std::fs::read_dir("/proc") else { return Vec::new() };
    let pids = entries.flatten().filter_map(|entry| entry.file_name().to_str()?.parse::<u32>().ok());
    pids.filter(|&pid| pid != std::process::id() && was_started_with(pid, address)).collect()
}

fn was_started_with(pid: u32, address: &WireAddress) -> bool {
    // Anybody can start a process with such a command line.
    if !std::fs::metadata(format!("/proc/{pid}")).is_ok_and(|metadata| metadata.uid() == geteuid().as_raw()) {
        return false;
    }
    let wanted = format!("{}@", address.prefix());
    std::fs::read(format!("/proc/{pid}/cmdline")).is_ok_and(|line| {
        line.split(|&byte| byte == 0).any(|argument| {
            let value = argument.strip_prefix(b"--wire=").unwrap_or(argument);
            value.starts_with(wanted.as_bytes())
        })
    })
}

fn is_mapped(prefix: &str) -> bool {
    let wanted = format!("{SHARED_MEMORY}/{prefix}");
    let Ok(entries) = std::fs::read_dir("/proc") else { return false };
    let mut pids = entries.flatten().filter(|entry| entry.file_name().to_string_lossy().parse::<u32>().is_ok());
    pids.any(|entry| std::fs::read_to_string(entry.path().join("maps")).is_ok_and(|maps| maps.contains(&wanted)))
}

#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub struct Swept {
    pub names: usize,
    pub killed: usize,
}

/// Removes what a dead incarnation left. Its processes notice by themselves that their orchestrator is gone; those
/// that have not left after `patience` are killed. Fails if the incarnation lives: a copied or forged run folder can
/// carry the id of a run at work.
pub fn sweep(address: &WireAddress, patience: Duration) -> Result<Swept> {
    let begin = Instant::now();
    while open_owner(address).is_some_and(|owner| is_locked(&owner)) {
        if begin.elapsed() >= patience {
            bail!(
                "an orchestrator that runs holds {}, so nothing of it is removed: end that run first \
                 (`orchestrator stop`)",
                owner_file(address).display()
            );
        }
        // The kernel wakes for a released lock only those who wait without a deadline.
        std::thread::sleep(Duration::from_millis(20));
    }
    let mut swept = Swept::default();
    let outlived = await_ends(address, patience);
    for &pid in &outlived {
        tracing::warn!("process {pid} has outlived its orchestrator ({}) and is killed", address.prefix());
        swept.killed += usize::from(kill(pid, address));
    }
    if !outlived.is_empty() {
        await_ends(address, KILLED_ENDS);
    }
    swept.names =
        address.sweep().with_context(|| format!("cannot remove what {} left in /dev/shm", address.prefix()))?;
    Ok(swept)
}

/// Kills a process, if it still is the one that was found: a descriptor of it is taken before its command line is
/// read again, so its number cannot have passed to another in between.
fn kill(pid: u32, address: &WireAddress) -> bool {
    let Ok(Some((descriptor, listed))) = open_process(pid) else { return false };
    // The number is one of /proc's, which can be that of another PID namespace.
    listed == pid
        && was_started_with(pid, address)
        && rustix::process::pidfd_send_signal(&descriptor, rustix::process::Signal::KILL).is_ok()
}

fn await_ends(address: &WireAddress, patience: Duration) -> Vec<u32> {
    let begin = Instant::now();
    loop {
        let left = processes_of(address);
        let time_left = patience.saturating_sub(begin.elapsed());
        match left.first().and_then(|&pid| Pid::from_raw(i32::try_from(pid).ok()?)) {
            Some(first) if !time_left.is_zero() => sleep_until_end(first, time_left),
            _ => return left,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::process::{Command, Stdio};

    fn address(test: &str) -> WireAddress {
        WireAddress::new(&format!("test{test}{}", std::process::id()), 7)
    }

    fn wait_until(condition: impl Fn() -> bool, patience: Duration) -> bool {
        let begin = Instant::now();
        while !condition() {
            if begin.elapsed() >= patience {
                return false;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        true
    }

    fn found(address: &WireAddress) -> Option<Remains> {
        survey().unwrap().into_iter().find(|remains| remains.address == *address)
    }

    #[test]
    fn a_claim_lives_as_long_as_its_owner_and_is_swept_after() {
        let address = address("claim");
        let claim = claim(&address, Path::new("/somewhere/run")).unwrap();
        assert!(super::claim(&address, Path::new("/other")).is_err(), "claimed once");
        let remains = found(&address).unwrap();
        assert!(remains.alive);
        let message = sweep(&address, Duration::ZERO).unwrap_err().to_string();
        assert!(message.contains("orchestrator stop") && owner_file(&address).exists(), "{message}");
        assert_eq!(remains.run.as_deref(), Some(Path::new("/somewhere/run")));
        drop(claim);
        assert!(!found(&address).unwrap().alive);
        assert_eq!(sweep(&address, Duration::ZERO).unwrap(), Swept { names: 1, killed: 0 });
        assert!(found(&address).is_none());
    }

    #[test]
    fn an_owner_file_names_nothing_that_is_deleted() {
        let address = address("planted");
        let precious = tempfile::tempdir().unwrap();
        let forged = format!(r#"{{"wire":"{}@{}","run":"/r","pid":1}}"#, address.prefix(), precious.path().display());
        std::fs::write(owner_file(&address), forged).unwrap();
        let remains = found(&address).unwrap();
        assert!(!remains.alive, "it is signed and nobody holds it");
        assert_eq!(remains.run.as_deref(), Some(Path::new("/r")), "an older program's signature is read");
        assert_eq!(sweep(&remains.address, Duration::ZERO).unwrap().names, 1);
        assert!(precious.path().is_dir());
    }

    #[test]
    fn an_owner_file_that_is_a_link_or_a_pipe_is_not_opened() {
        let address = address("pipe");
        let signed = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(signed.path(), r#"{"run":"/r","pid":1}"#).unwrap();
        signed.as_file().try_lock().unwrap();
        std::os::unix::fs::symlink(signed.path(), owner_file(&address)).unwrap();
        assert!(open_owner(&address).is_none());
        std::fs::remove_file(owner_file(&address)).unwrap();
        assert!(Command::new("mkfifo").arg(owner_file(&address)).status().unwrap().success());
        assert!(open_owner(&address).is_none());
        std::fs::remove_file(owner_file(&address)).unwrap();
    }

    #[test]
    fn unsigned_names_are_alive_while_a_process_has_them_in_memory() {
        use proto::config::Config;
        use proto::shares::Shares;
        use wire::{WireHost, WireShape};
        let address = address("mapped");
        let host = WireHost::create(&address, WireShape::new(Shares::of_one(1), 1, Config::default().spec())).unwrap();
        assert!(is_mapped(address.prefix()));
        drop(host);
        assert!(!is_mapped(address.prefix()));
        sweep(&address, Duration::ZERO).unwrap();
    }

    #[test]
    fn a_process_that_outlived_its_orchestrator_is_killed_after_patience() {
        let address = address("orphan");
        let mut orphan = Command::new("sh")
            .args(["-c", "while :; do sleep 0.1; done", "actor", "--wire"])
            .arg(address.to_string())
            .stdin(Stdio::null())
            .spawn()
            .unwrap();
        let reaper = std::thread::spawn(move || orphan.wait().unwrap());
        assert!(wait_until(|| processes_of(&address).len() == 1, Duration::from_secs(5)));
        let swept = sweep(&address, Duration::from_millis(200)).unwrap();
        assert_eq!(swept.killed, 1);
        assert!(!reaper.join().unwrap().success());
        assert!(processes_of(&address).is_empty());
    }
}
