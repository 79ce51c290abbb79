//! A run folder whose making was cut off: the orchestrator was killed after it made the folder, and before it wrote the
//! identity, which makes it a run. Nothing is lost with it, so the next one takes it over.

use proto::run_folder::RunFolder;
use std::io::Result;
use std::path::{Path, PathBuf};

/// Whether a folder holds only what is in a run folder before its identity: empty folders, and beside an orchestrator's
/// lock the configuration, the task and copies of scenes. False for one that holds nothing, or the work of a run.
pub fn is_cut_off(folder: &RunFolder) -> Result<bool> {
    let folders = [folder.logs(), folder.checkpoints(), folder.recordings()];
    let lock = folder.orchestrator_lock();
    // Without the lock it is somebody else's file that has the same name.
    let files = if lock.exists() {
        let written = [folder.config(), folder.task()];
        let partial = [folder.identity(), folder.config(), folder.task()].map(|path| partial(&path));
        written.into_iter().chain(partial).chain([folder.scenes(), lock]).collect()
    } else {
        vec![]
    };
    let mut any = false;
    for entry in std::fs::read_dir(folder.root())? {
        let path = entry?.path();
        let is_empty_folder = || Ok::<_, std::io::Error>(path.is_dir() && std::fs::read_dir(&path)?.next().is_none());
        let ours = files.contains(&path) || (folders.contains(&path) && is_empty_folder()?);
        if !ours {
            return Ok(false);
        }
        any = true;
    }
    Ok(any)
}

pub fn clear(folder: &RunFolder) -> Result<()> {
    match std::fs::remove_dir_all(folder.scenes()) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

fn partial(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(proto::run_folder::PARTIAL);
    name.into()
}
