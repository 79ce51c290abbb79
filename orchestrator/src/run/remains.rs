//! Remains of dead incarnations: names in /dev/shm, a folder of small files, perhaps a hanging process.
//!
//! An orchestrator claims its names by holding a lock on `/dev/shm/PREFIXowner` for as long as it lives. The kernel
//! releases the lock when the process dies: a free lock means a dead owner, even if another process has its id by now.
//! The file lies in /dev/shm, so it is found under any TMPDIR, and it contains the folder's path.

use crate::run::process_end::sleep_until_end;
use anyhow::{Context, Result};
use rustix::process::Pid;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::Write;
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};
use wire::{PREFIX_MARK, SHARED_MEMORY, WireAddress};

/// An owner file is locked and signed within this time of its creation; a younger one without an owner is left alone.
const CLAIMING: Duration = Duration::from_secs(10);
/// How long a killed process may take to be gone.
const KILLED_ENDS: Duration = Duration::from_secs(5);

/// The claim on one incarnation's names, until dropped.
#[derive(Debug)]
pub struct Claim {
    _file: File,
}

#[derive(Debug, Serialize, Deserialize)]
struct Signature {
    wire: String,
    run: PathBuf,
    pid: u32,
}

/// Claims the names at `address` for the run in `run`. To be done before anything else is created there.
pub fn claim(address: &WireAddress, run: &Path) -> Result<Claim> {
    let path = owner_file(address.prefix());
    let mut file = OpenOptions::new()
        .create_new(true)
        .write(true)
        .mode(0o600)
        .open(&path)
        .with_context(|| format!("cannot create {}", path.display()))?;
    file.try_lock().map_err(std::io::Error::from).with_context(|| format!("cannot lock {}", path.display()))?;
    let signature = Signature { wire: address.to_string(), run: run.to_path_buf(), pid: std::process::id() };
    file.write_all(serde_json::to_string(&signature)?.as_bytes())
        .with_context(|| format!("cannot write {}; is /dev/shm full?", path.display()))?;
    Ok(Claim { _file: file })
}

fn owner_file(prefix: &str) -> PathBuf {
    Path::new(SHARED_MEMORY).join(format!("{prefix}owner"))
}

/// What lies in shared memory under one prefix.
#[derive(Debug)]
pub struct Remains {
    /// Address, as far as it is known.
    pub address: WireAddress,
    /// The run it belongs to, if its owner signed.
    pub run: Option<PathBuf>,
    /// Names in /dev/shm.
    pub names: usize,
    /// Memory they hold, bytes.
    pub bytes: u64,
    /// True while its orchestrator lives (or someone is just starting there).
    pub alive: bool,
}

/// Everything of this user's runs that lies in /dev/shm or the temporary folder, living and dead.
pub fn survey() -> Result<Vec<Remains>> {
    let me = rustix::process::getuid().as_raw();
    let mut found: BTreeMap<String, (usize, u64, SystemTime)> = BTreeMap::new();
    for entry in std::fs::read_dir(SHARED_MEMORY).context(SHARED_MEMORY)? {
        let entry = entry?;
        let (Some(prefix), Ok(metadata)) = (prefix_of(&entry.file_name().to_string_lossy()), entry.metadata()) else {
            continue;
        };
        if metadata.uid() == me {
            let group = found.entry(prefix).or_insert((0, 0, SystemTime::UNIX_EPOCH));
            group.0 += 1;
            group.1 += metadata.blocks() * 512;
            group.2 = group.2.max(metadata.modified().unwrap_or(SystemTime::UNIX_EPOCH));
        }
    }
    for entry in std::fs::read_dir(std::env::temp_dir())?.flatten() {
        let name = format!("{}_", entry.file_name().to_string_lossy());
        if let (Some(prefix), Ok(metadata)) = (prefix_of(&name), entry.metadata())
            && prefix == name
            && metadata.uid() == me
        {
            let changed = metadata.modified().unwrap_or(SystemTime::UNIX_EPOCH);
            found.entry(prefix).or_insert((0, 0, changed));
        }
    }
    found.into_iter().map(|(prefix, (names, bytes, changed))| examine(&prefix, names, bytes, changed)).collect()
}

fn examine(prefix: &str, names: usize, bytes: u64, changed: SystemTime) -> Result<Remains> {
    let path = owner_file(prefix);
    let signature: Option<Signature> =
        std::fs::read_to_string(&path).ok().and_then(|text| serde_json::from_str(&text).ok());
    let locked = match File::open(&path) {
        Ok(file) => matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock)),
        Err(_) => false,
    };
    let young = changed.elapsed().is_ok_and(|age| age < CLAIMING);
    let signed_address = signature.as_ref().and_then(|signature| signature.wire.parse::<WireAddress>().ok());
    let address = if let Some(address) = signed_address.filter(|address| address.prefix() == prefix) {
        address
    } else {
        let root = std::env::temp_dir().join(prefix.trim_end_matches('_'));
        format!("{prefix}@{}", root.display()).parse()?
    };
    // Without an owner's signature (another program's services, a test's) use is what shows life.
    let alive = locked || (signature.is_none() && (young || is_mapped(prefix)));
    Ok(Remains { address, run: signature.map(|signature| signature.run), names, bytes, alive })
}

/// `stillroom_ID_INCARNATION_` of a name that begins so.
fn prefix_of(name: &str) -> Option<String> {
    let mut parts = name.strip_prefix(PREFIX_MARK)?.splitn(3, '_');
    let (id, incarnation, _) = (parts.next()?, parts.next()?, parts.next()?);
    let valid = !id.is_empty()
        && id.bytes().all(|byte| byte.is_ascii_alphanumeric())
        && !incarnation.is_empty()
        && incarnation.bytes().all(|byte| byte.is_ascii_digit());
    valid.then(|| format!("{PREFIX_MARK}{id}_{incarnation}_"))
}

/// Processes that were started with this address on their command line.
pub fn processes_of(address: &WireAddress) -> Vec<u32> {
    let Ok(entries) = std::fs::read_dir("/proc") else { return Vec::new() };
    let pids = entries.flatten().filter_map(|entry| entry.file_name().to_str()?.parse::<u32>().ok());
    pids.filter(|&pid| pid != std::process::id() && was_started_with(pid, address)).collect()
}

fn was_started_with(pid: u32, address: &WireAddress) -> bool {
    let wanted = format!("{}@", address.prefix());
    std::fs::read(format!("/proc/{pid}/cmdline")).is_ok_and(|line| {
        line.split(|&byte| byte == 0).any(|argument| {
            let value = argument.strip_prefix(b"--wire=").unwrap_or(argument);
            value.starts_with(wanted.as_bytes())
        })
    })
}

/// Whether a process that we may look at has one of these names in its memory.
fn is_mapped(prefix: &str) -> bool {
    let wanted = format!("{SHARED_MEMORY}/{prefix}");
    let Ok(entries) = std::fs::read_dir("/proc") else { return false };
    let mut pids = entries.flatten().filter(|entry| entry.file_name().to_string_lossy().parse::<u32>().is_ok());
    pids.any(|entry| std::fs::read_to_string(entry.path().join("maps")).is_ok_and(|maps| maps.contains(&wanted)))
}

/// What a sweep did.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub struct Swept {
    /// Names removed.
    pub names: usize,
    /// Processes that had to be killed.
    pub killed: usize,
}

/// Removes what a dead incarnation left. Its processes notice by themselves that their orchestrator is gone; those
/// that have not left after `patience` are killed.
pub fn sweep(address: &WireAddress, patience: Duration) -> Result<Swept> {
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
    let Some(pid_number) = i32::try_from(pid).ok().and_then(Pid::from_raw) else { return false };
    let Ok(descriptor) = rustix::process::pidfd_open(pid_number, rustix::process::PidfdFlags::empty()) else {
        return false;
    };
    was_started_with(pid, address)
        && rustix::process::pidfd_send_signal(&descriptor, rustix::process::Signal::KILL).is_ok()
}

/// Waits until no process of an address is left, at most for `patience`; returns those that are.
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
    fn names_are_taken_apart_and_strangers_left_alone() {
        assert_eq!(prefix_of("stillroom_0a1b_12_x.y"), Some("stillroom_0a1b_12_".into()));
        assert_eq!(prefix_of("stillroom_0a1b_12_"), Some("stillroom_0a1b_12_".into()));
        for stranger in ["stillroom_", "stillroom_0a1b_12", "stillroom_0a-b_12_", "stillroom_0a1b_x_", "other_a_1_"] {
            assert_eq!(prefix_of(stranger), None, "{stranger}");
        }
    }

    #[test]
    fn a_claim_lives_as_long_as_its_owner_and_is_swept_after() {
        let address = address("claim");
        let claim = claim(&address, Path::new("/somewhere/run")).unwrap();
        assert!(super::claim(&address, Path::new("/other")).is_err(), "claimed once");
        let remains = found(&address).unwrap();
        assert!(remains.alive);
        assert_eq!(remains.run.as_deref(), Some(Path::new("/somewhere/run")));
        drop(claim);
        assert!(!found(&address).unwrap().alive);
        assert_eq!(sweep(&address, Duration::ZERO).unwrap(), Swept { names: 1, killed: 0 });
        assert!(found(&address).is_none());
    }

    #[test]
    fn unsigned_names_are_alive_while_a_process_has_them_in_memory() {
        use proto::shares::Shares;
        use wire::{WireHost, WireShape};
        let address = address("mapped");
        let host =
            WireHost::create(&address, WireShape { shares: Shares::of_one(1), environments_per_actor: 1 }).unwrap();
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
