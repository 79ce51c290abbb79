//! A disk of a case's own, whose power can fail: ext4 in a file, on a loop device. What a program has written and not
//! synced is in the kernel's memory alone; after [`Disk::fail`] it never reaches the file, as after a power cut.

use anyhow::{Context, Result, ensure};
use rustix::ioctl::{Setter, ioctl, opcode};
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// `FS_IOC_SHUTDOWN`: the file system takes no more requests.
const SHUTDOWN: rustix::ioctl::Opcode = opcode::read::<u32>(b'X', 125);
/// `EXT4_GOING_FLAGS_NOLOGFLUSH`: at once, without writing its journal first.
const WITHOUT_FLUSH: u32 = 2;
/// How long a file system may be in use after its last process has ended.
const BUSY: Duration = Duration::from_secs(20);

#[derive(Debug)]
pub struct Disk {
    image: PathBuf,
    folder: PathBuf,
}

impl Disk {
    /// A new one of so many mebibytes, mounted at `folder`; its image lies beside it.
    pub fn new(folder: &Path, mebibytes: u32) -> Result<Self> {
        let image = folder.with_extension("disk");
        File::create(&image)
            .and_then(|file| file.set_len(u64::from(mebibytes) << 20))
            .with_context(|| image.display().to_string())?;
        call(Command::new("mkfs.ext4").args(["-q", "-F", "-m", "0"]).arg(&image))?;
        let disk = Self { image, folder: folder.to_owned() };
        disk.mount()?;
        Ok(disk)
    }

    fn mount(&self) -> Result<()> {
        call(Command::new("mount").args(["-o", "loop"]).arg(&self.image).arg(&self.folder)).map(drop)
    }

    /// What is there now outlasts the power.
    pub fn settle(&self) -> Result<()> {
        rustix::fs::syncfs(File::open(&self.folder)?).context("cannot sync a disk")
    }

    /// The power fails.
    pub fn fail(&self) -> Result<()> {
        let folder = File::open(&self.folder)?;
        // SAFETY: the request reads one u32, which is what is passed.
        unsafe { ioctl(&folder, Setter::<SHUTDOWN, u32>::new(WITHOUT_FLUSH)) }.context("cannot cut the power of a disk")
    }

    /// The power is back: mounted again, with what had reached the disk. Nobody may use it.
    pub fn restore(&self) -> Result<()> {
        let begun = Instant::now();
        while let Err(error) = call(Command::new("umount").arg(&self.folder)) {
            ensure!(begun.elapsed() < BUSY, "{error:#}");
            std::thread::sleep(Duration::from_millis(20));
        }
        // A namespace of mounts that is about to vanish holds it a little longer: mounted now, it would be the old one.
        while !call(Command::new("losetup").arg("-j").arg(&self.image))?.is_empty() {
            ensure!(begun.elapsed() < BUSY, "{} is still in use", self.image.display());
            std::thread::sleep(Duration::from_millis(20));
        }
        self.mount()
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        // Lazily: a process that outlives its case must not keep the mount.
        let _ = call(Command::new("umount").arg("--lazy").arg(&self.folder));
        let _ = std::fs::remove_file(&self.image);
    }
}

/// What a command prints.
fn call(command: &mut Command) -> Result<String> {
    let output = command.stdin(Stdio::null()).output().with_context(|| format!("{command:?}"))?;
    let said = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "{command:?}: {}", said.trim());
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    #[test]
    fn what_was_not_synced_is_gone_after_a_power_cut() {
        if !rustix::process::geteuid().is_root() || !Path::new("/dev/loop-control").exists() {
            println!("not tested: this user may not mount a disk");
            return;
        }
        let temporary = tempfile::tempdir().unwrap();
        let folder = temporary.path().join("mounted");
        std::fs::create_dir(&folder).unwrap();
        let disk = Disk::new(&folder, 16).unwrap();
        std::fs::write(folder.join("settled"), "text").unwrap();
        disk.settle().unwrap();
        // In place: a file that is cut and written anew is synced by ext4 of its own accord.
        File::options().write(true).open(folder.join("settled")).unwrap().write_all(b"next").unwrap();
        std::fs::write(folder.join("loose"), "text").unwrap();
        let mut synced = File::create(folder.join("synced")).unwrap();
        synced.write_all(b"text").unwrap();
        synced.sync_all().unwrap();
        disk.fail().unwrap();
        assert!(File::create(folder.join("late")).is_err(), "nothing works without power");
        drop(synced);
        disk.restore().unwrap();
        let text = |name: &str| std::fs::read_to_string(folder.join(name)).unwrap_or_default();
        assert_eq!(text("synced"), "text");
        assert_eq!(text("settled"), "text");
        assert_eq!(text("loose"), "");
        drop(disk);
        assert_eq!(std::fs::read_dir(temporary.path()).unwrap().count(), 1, "only the folder is left");
    }
}
