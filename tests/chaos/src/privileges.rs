//! What the machine lets the harness do; faults that need more are skipped, and said to be.

use crate::disk::Disk;
use std::process::{Command, Stdio};

/// What the machine lets us do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Privileges {
    /// Mount file systems in memory.
    pub mounts: bool,
    /// Mount disks.
    pub disks: bool,
}

impl Privileges {
    /// Tried out: the first in a namespace of its own.
    pub fn probe() -> Self {
        let mount = format!("mount -t tmpfs -o size=1m chaos {}", wire::SHARED_MEMORY);
        let tried = Command::new("unshare")
            .args(["--mount", "--propagation", "private", "sh", "-c", &mount])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status();
        let disk = || -> anyhow::Result<()> {
            let folder = tempfile::tempdir()?;
            let mounted = folder.path().join("probe");
            std::fs::create_dir(&mounted)?;
            // Unmounted before its folder is removed.
            Disk::new(&mounted, 4).map(drop)
        };
        Self { mounts: tried.is_ok_and(|status| status.success()), disks: disk().is_ok() }
    }
}
