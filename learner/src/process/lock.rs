//! At most one learner for each run and rank: only the holder of the lock may write checkpoints.

use anyhow::{Context, Result, bail};
use proto::plain_file::open_plain;
use rustix::fs::{FlockOperation, flock};
use std::fs::File;
use std::io::{Read, Seek, Write};
use std::path::Path;
use std::time::{Duration, Instant};

/// Time that a predecessor has to save and exit.
pub const PATIENCE: Duration = Duration::from_mins(1);

/// A held lock; the kernel releases it when the process ends, however it ends.
#[derive(Debug)]
pub struct Lock {
    _file: File,
}

impl Lock {
    /// Takes the lock, waiting up to `patience` for its holder to exit. `stop` ends the wait early.
    pub fn take(path: &Path, patience: Duration, stop: impl Fn() -> bool) -> Result<Self> {
        let cannot = || format!("cannot open the learner's lock {}", path.display());
        let mut file = open_plain(path, File::options().create(true).truncate(false).read(true).write(true))
            .with_context(cannot)?;
        let began = Instant::now();
        let mut told = false;
        loop {
            match flock(&file, FlockOperation::NonBlockingLockExclusive) {
                Ok(()) => break,
                Err(rustix::io::Errno::WOULDBLOCK | rustix::io::Errno::INTR) => {}
                Err(cause) => return Err(cause).with_context(|| format!("cannot lock {}", path.display())),
            }
            if began.elapsed() >= patience || stop() {
                bail!(
                    "another learner{} still works on this run: it holds {} (waited {:.0} s)",
                    holder(&mut file),
                    path.display(),
                    began.elapsed().as_secs_f64()
                );
            }
            if !told {
                told = true;
                tracing::info!("waiting for another learner{} to release {}", holder(&mut file), path.display());
            }
            // The kernel wakes for a released lock only those who wait without a deadline.
            std::thread::sleep(Duration::from_millis(100));
        }
        // For the message above only: the lock itself is the kernel's. So a full disk is no reason to end; and what is
        // overwritten before the rest is cut off needs no new space.
        let own = format!("{}\n", std::process::id());
        let noted = file.rewind().and_then(|()| file.write_all(own.as_bytes()));
        if let Err(cause) = noted.and_then(|()| file.set_len(own.len() as u64)) {
            tracing::debug!("{}: cannot note this process in it: {cause}", path.display());
        }
        Ok(Self { _file: file })
    }
}

fn holder(file: &mut File) -> String {
    let mut text = String::new();
    let read = file.rewind().and_then(|()| file.take(64).read_to_string(&mut text));
    if read.is_ok() && !text.trim().is_empty() { format!(" (process {})", text.trim()) } else { String::new() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lock_that_is_a_link_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let (precious, path) = (folder.path().join("precious"), folder.path().join("learner-0.lock"));
        std::fs::write(&precious, "precious").unwrap();
        std::os::unix::fs::symlink(&precious, &path).unwrap();
        let error = format!("{:#}", Lock::take(&path, Duration::ZERO, || false).unwrap_err());
        assert!(error.contains("a link"), "{error}");
        assert_eq!(std::fs::read_to_string(&precious).unwrap(), "precious");
    }

    #[test]
    fn a_second_holder_waits_then_names_the_first() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("learner-0.lock");
        let first = Lock::take(&path, Duration::ZERO, || false).unwrap();
        let error = Lock::take(&path, Duration::from_millis(250), || false).unwrap_err().to_string();
        assert!(error.contains(&format!("process {}", std::process::id())), "{error}");
        let waiter = {
            let path = path.clone();
            std::thread::spawn(move || Lock::take(&path, Duration::from_secs(20), || false).is_ok())
        };
        std::thread::sleep(Duration::from_millis(150));
        drop(first);
        assert!(waiter.join().unwrap(), "a lock that is let go is taken");
    }
}
