//! A signal to the orchestrator or learner that holds a run, and to no other process.
//!
//! A lock names its holder, but a run folder can come from anybody: any process of ours could stand there. So a process
//! is signalled only if it is ours, runs our program, and has this very lock file open.

use anyhow::{Context, Result, bail};
use rustix::io::Errno;
use rustix::process::{Pid, PidfdFlags, Signal, geteuid, pidfd_open, pidfd_send_signal};
use std::ffi::{OsStr, OsString};
use std::os::fd::{AsRawFd, OwnedFd};
use std::os::unix::fs::MetadataExt;
use std::path::Path;

/// Asks the orchestrator that holds a lock to save and stop; whether it was there to be asked.
pub fn ask_to_stop(pid: u32, lock: &Path) -> Result<bool> {
    send(pid, lock, &program("/proc/self")?, Signal::TERM)
}

/// Has the learner that holds a lock go on, if it is stopped; whether it was there.
pub fn wake_learner(pid: u32, lock: &Path) -> Result<bool> {
    send(pid, lock, OsStr::new("learner"), Signal::CONT)
}

fn send(pid: u32, lock: &Path, program: &OsStr, signal: Signal) -> Result<bool> {
    // Before anything is read of the process: from here on its number cannot pass to another unnoticed.
    let Some((descriptor, listed)) = open_process(pid).with_context(|| format!("cannot look at pid {pid}"))? else {
        return Ok(false);
    };
    check(listed, lock, program).with_context(|| {
        format!("{} names pid {pid}, which is not signalled; a run of yours is stopped with Ctrl-C too", lock.display())
    })?;
    match pidfd_send_signal(&descriptor, signal) {
        Ok(()) => Ok(true),
        Err(Errno::SRCH) => Ok(false),
        Err(error) => bail!("cannot signal pid {pid}: {error}"),
    }
}

/// A descriptor of the process with this number, and its number in /proc, which can be that of another PID namespace; none
/// where there is no such process.
pub fn open_process(pid: u32) -> Result<Option<(OwnedFd, u32)>, Errno> {
    let Some(process) = i32::try_from(pid).ok().and_then(Pid::from_raw) else { return Ok(None) };
    let descriptor = match pidfd_open(process, PidfdFlags::empty()) {
        Err(Errno::SRCH) => return Ok(None),
        opened => opened?,
    };
    let info = std::fs::read_to_string(format!("/proc/self/fdinfo/{}", descriptor.as_raw_fd())).unwrap_or_default();
    let listed = info.lines().find_map(|line| line.strip_prefix("Pid:")?.trim().parse().ok());
    Ok(Some((descriptor, listed.unwrap_or(pid))))
}

/// Fails unless the process runs this program for this user and has this lock file of this user's open.
fn check(pid: u32, lock: &Path, ours: &OsStr) -> Result<()> {
    let me = geteuid().as_raw();
    let file = std::fs::symlink_metadata(lock)?;
    if !file.is_file() || file.uid() != me {
        bail!("the lock is not a file of this user's");
    }
    let process = format!("/proc/{pid}");
    if std::fs::metadata(&process)?.uid() != me {
        bail!("the process is another user's: stop the run as that user");
    }
    if program(&process)? != ours {
        bail!("the process is no {}", if ours == "learner" { "learner" } else { "orchestrator" });
    }
    let open = std::fs::read_dir(format!("{process}/fd"))?.flatten();
    let mut open = open.filter_map(|entry| std::fs::metadata(entry.path()).ok());
    if !open.any(|other| (other.dev(), other.ino()) == (file.dev(), file.ino())) {
        bail!("the process does not hold the lock");
    }
    Ok(())
}

fn program(process: &str) -> Result<OsString> {
    let path = std::fs::read_link(format!("{process}/exe"))?;
    let name = path.file_name().context("a program has a name")?.to_string_lossy().into_owned();
    Ok(name.trim_end_matches(" (deleted)").into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::File;
    use std::os::unix::process::ExitStatusExt;
    use std::process::{Child, Command};

    fn reason(pid: u32, lock: &Path) -> String {
        format!("{:#}", check(pid, lock, &program("/proc/self").unwrap()).unwrap_err())
    }

    /// Ends a child that is to have been left alone; panics if something else ended it.
    fn was_left_alone(mut child: Child) {
        child.kill().unwrap();
        assert_eq!(child.wait().unwrap().signal(), Some(Signal::KILL.as_raw()));
    }

    #[test]
    fn only_an_orchestrator_that_has_the_lock_open_is_its_holder() {
        let folder = tempfile::tempdir().unwrap();
        let (lock, other, link) = (folder.path().join("lock"), folder.path().join("other"), folder.path().join("link"));
        let _held = File::create(&lock).unwrap();
        drop(File::create(&other).unwrap());
        std::os::unix::fs::symlink(&lock, &link).unwrap();
        let me = std::process::id();
        check(me, &lock, &program("/proc/self").unwrap()).unwrap();
        assert!(format!("{:#}", wake_learner(me, &lock).unwrap_err()).contains("no learner"));
        assert!(reason(me, &other).contains("does not hold"));
        assert!(reason(me, &link).contains("not a file"));
        // A build has replaced its file since.
        std::os::unix::fs::symlink("/built/orchestrator (deleted)", folder.path().join("exe")).unwrap();
        assert_eq!(program(folder.path().to_str().unwrap()).unwrap(), "orchestrator");
    }

    #[test]
    fn a_planted_process_is_not_signalled() {
        let folder = tempfile::tempdir().unwrap();
        let lock = folder.path().join("lock");
        let held = File::create(&lock).unwrap();
        // Another program, with the lock open and without.
        let holding = Command::new("sleep").arg("60").stdin(held.try_clone().unwrap()).spawn().unwrap();
        let sleeping = Command::new("sleep").arg("60").spawn().unwrap();
        for child in [holding, sleeping] {
            let message = format!("{:#}", ask_to_stop(child.id(), &lock).unwrap_err());
            assert!(message.contains("no orchestrator") && message.contains("not signalled"), "{message}");
            was_left_alone(child);
        }
        // Nobody is there to be asked.
        assert!(!ask_to_stop(0, &lock).unwrap());
        let mut gone = Command::new("true").spawn().unwrap();
        gone.wait().unwrap();
        assert!(!ask_to_stop(gone.id(), &lock).unwrap());
    }
}
