//! Where a case happens: its files, on a small file system of its own where its disk is to be filled, and its
//! commands, with a small /dev/shm of their own where that is to be filled. What the commands print lies elsewhere: on a
//! full disk the reason of an end would be lost.

use crate::disk::Disk;
use crate::fault::Fault;
use anyhow::{Context, Result, ensure};
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// `orchestrator up` wants 256 MiB free beside its checkpoints, which take up to 90 MiB.
const DISK_MIB: u32 = 400;
/// The largest shape needs 22 MiB.
const MEMORY_MIB: u32 = 48;

#[derive(Debug)]
pub struct CaseFolder {
    root: PathBuf,
    /// What the commands work with.
    files: PathBuf,
    storage: Storage,
    has_own_memory: bool,
}

/// What a case's files lie on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Medium {
    /// The file system of the harness.
    Shared,
    /// A small one of its own in memory, which can be filled.
    Memory,
    /// A small disk of its own, which can be filled, and whose power can fail.
    Disk,
}

#[derive(Debug)]
enum Storage {
    Shared,
    Memory,
    Disk(Disk),
}

#[derive(Debug, Clone, Default)]
pub struct Start {
    /// The fault point that is armed.
    pub point: Option<String>,
    /// Files that it may open.
    pub descriptors: Option<u64>,
}

impl Start {
    /// Arms what happens with a start.
    pub fn arm(&mut self, fault: Fault) {
        match fault {
            // Only an actor passes those, and where environments are not built in its program is any.
            Fault::Point(point, pass) if point.name.starts_with("actor.") => {
                self.point = Some(format!("{}:{pass}", point.name));
            }
            Fault::Point(point, pass) => self.point = Some(format!("{}:{pass}@{}", point.name, point.program)),
            Fault::FewDescriptors(limit) => self.descriptors = Some(limit),
            _ => {}
        }
    }
}

impl CaseFolder {
    /// A new one, empty.
    pub fn new(root: PathBuf, medium: Medium, own_memory: bool) -> Result<Self> {
        let files = root.join("files");
        std::fs::create_dir_all(&files).with_context(|| files.display().to_string())?;
        let storage = match medium {
            Medium::Shared => Storage::Shared,
            Medium::Memory => {
                let size = format!("size={DISK_MIB}m");
                let status = Command::new("mount").args(["-t", "tmpfs", "-o", &size, "chaos"]).arg(&files).status()?;
                ensure!(status.success(), "cannot mount a file system at {}", files.display());
                Storage::Memory
            }
            Medium::Disk => Storage::Disk(Disk::new(&files, DISK_MIB)?),
        };
        Ok(Self { root, files, storage, has_own_memory: own_memory })
    }

    /// Its disk, if it has one of its own.
    pub fn disk(&self) -> Option<&Disk> {
        if let Storage::Disk(disk) = &self.storage { Some(disk) } else { None }
    }

    /// A path among its files.
    pub fn path(&self, name: &str) -> PathBuf {
        self.files.join(name)
    }

    /// `orchestrator ARGUMENTS`, started; what it prints goes to `NAME.out` and `NAME.err`.
    pub fn start(&self, name: &str, arguments: &[&str], start: &Start) -> Result<Child> {
        let program = system_tests::binary("orchestrator");
        let mut prologue = Vec::new();
        if let Some(limit) = start.descriptors {
            prologue.push(format!("ulimit -n {limit}"));
        }
        if self.has_own_memory {
            // Its mounts are a copy of ours: the disk of another case would stay in use when its power fails.
            let cases = self.root.with_file_name("case-");
            let others =
                format!("for disk in '{}'*/files; do [ \"$disk\" -ef . ] || umount \"$disk\"; done", cases.display());
            prologue.push(format!("{{ {others}; true; }} 2>/dev/null"));
            prologue.push(format!("mount -t tmpfs -o size={MEMORY_MIB}m chaos {}", wire::SHARED_MEMORY));
        }
        let mut command = match (self.has_own_memory, prologue.is_empty()) {
            (true, _) => {
                let mut command = Command::new("unshare");
                command.args(["--mount", "--propagation", "private", "sh", "-c"]);
                command
            }
            (false, false) => {
                let mut command = Command::new("sh");
                command.arg("-c");
                command
            }
            (false, true) => Command::new(&program),
        };
        if !prologue.is_empty() {
            // The shell becomes the program: the number of the process is the program's.
            command.arg(format!("{} && exec \"$0\" \"$@\"", prologue.join(" && "))).arg(&program);
        }
        let output = |end: &str| File::create(self.root.join(format!("{name}.{end}")));
        command.args(arguments).current_dir(&self.files).stdin(Stdio::null());
        command.stdout(output("out")?).stderr(output("err")?);
        command.env_remove("STILLROOM_LOG").env_remove(wire::fault::VARIABLE);
        // Which commands of environments this user allows: what `up` names outlasts any disk.
        command.env("XDG_STATE_HOME", self.root.join("states"));
        command.envs(start.point.as_ref().map(|point| (wire::fault::VARIABLE, point)));
        command.spawn().with_context(|| program.display().to_string())
    }

    /// What a command has printed: standard output and standard error.
    pub fn printed(&self, name: &str) -> [String; 2] {
        ["out", "err"].map(|end| {
            let bytes = std::fs::read(self.root.join(format!("{name}.{end}"))).unwrap_or_default();
            String::from_utf8_lossy(&bytes).into_owned()
        })
    }

    /// Fills the case's own disk, or, with the number of one of its processes, its own /dev/shm. What is returned frees
    /// it again when it is dropped.
    pub fn fill(&self, process: Option<u32>) -> Result<Filler> {
        let folder = match process {
            None => self.files.clone(),
            Some(pid) => Path::new("/proc").join(pid.to_string()).join("root").join("dev/shm"),
        };
        let path = folder.join(FILLER);
        let file = File::create(&path).with_context(|| path.display().to_string())?;
        let status = rustix::fs::fstatvfs(&file)?;
        let free = status.f_bavail * status.f_frsize;
        ensure!(free < 1 << 30, "{} is not a small file system of the harness's own", folder.display());
        let mut end = 0;
        // From large pieces to small ones, until not even a page is left.
        let mut piece = 32 << 20;
        while piece >= 4096 {
            match rustix::fs::fallocate(&file, rustix::fs::FallocateFlags::empty(), end, piece) {
                Ok(()) => end += piece,
                Err(_) => piece /= 2,
            }
        }
        Ok(Filler { file, path })
    }

    /// Removes what an earlier full disk has left.
    pub fn clear(&self) -> Result<()> {
        match std::fs::remove_file(self.files.join(FILLER)) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error).context("cannot clear a disk"),
            _ => Ok(()),
        }
    }

    /// A file system of its own goes with it: what is needed to look into a failure is copied.
    pub fn keep(&self) -> Result<()> {
        if !matches!(self.storage, Storage::Shared) {
            let status = Command::new("cp").arg("-r").arg(&self.files).arg(self.root.join("kept")).status()?;
            ensure!(status.success(), "cannot copy {}, which goes with its file system", self.files.display());
        }
        Ok(())
    }

    /// Removes it with all that is in it.
    pub fn remove(self) -> Result<()> {
        let root = self.root.clone();
        drop(self);
        std::fs::remove_dir_all(&root).with_context(|| root.display().to_string())
    }
}

impl Drop for CaseFolder {
    fn drop(&mut self) {
        if matches!(self.storage, Storage::Memory) {
            // Lazily: a process that outlives its case must not keep the mount.
            let _ = Command::new("umount").arg("--lazy").arg(&self.files).status();
        }
    }
}

const FILLER: &str = "filler";

#[derive(Debug)]
pub struct Filler {
    file: File,
    path: PathBuf,
}

impl Drop for Filler {
    fn drop(&mut self) {
        // The path leads through a process that may have ended; the open file does not.
        let _ = self.file.set_len(0);
        let _ = std::fs::remove_file(&self.path);
    }
}
