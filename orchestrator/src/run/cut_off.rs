//! An evaluation that was cut off: its orchestrator is dead, and there is no result. It is made anew, not gone on with.

use super::identity::Identity;
use super::remains;
use anyhow::{Context, Result};
use proto::plain_file::open_plain;
use proto::run_folder::RunFolder;
use std::fs::OpenOptions;
use std::path::Path;
use std::time::Duration;
use wire::fault;

const PATIENCE: Duration = Duration::from_secs(2);

pub fn remove_evaluation(result: &Path) -> Result<()> {
    if !result.exists() {
        return Ok(());
    }
    if let Ok(identity) = Identity::read(&RunFolder::new(result)) {
        for incarnation in identity.incarnations.iter().filter(|incarnation| incarnation.ended.is_none()) {
            remains::sweep(&identity.address(incarnation), PATIENCE)?;
        }
    }
    remove(&RunFolder::new(result)).with_context(|| format!("cannot remove {}", result.display()))
}

/// Removes a folder in such an order that a kill at any moment leaves an evaluation that was cut off, or one that had
/// only begun to be made (`unfinished.rs`): both are taken by whoever comes next. With its `run.toml` gone before the
/// rest, it would be a folder that nobody knows, and that is never removed.
fn remove(folder: &RunFolder) -> std::io::Result<()> {
    let root = folder.root();
    if root.is_symlink() {
        return std::fs::remove_file(root);
    }
    // By its lock an evaluation that lost its identity is known: `run.toml` first, then the configuration, then the lock.
    let last = [folder.identity(), folder.config(), folder.orchestrator_lock()];
    open_plain(&last[2], OpenOptions::new().create(true).truncate(false).write(true))?;
    let entries = std::fs::read_dir(root)?.map(|entry| Ok(entry?.path())).collect::<std::io::Result<Vec<_>>>()?;
    for path in entries.iter().filter(|path| !last.contains(path)).chain(&last) {
        let removed = if path.is_dir() && !path.is_symlink() {
            std::fs::remove_dir_all(path)
        } else {
            std::fs::remove_file(path)
        };
        match removed {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(error),
            _ => fault::reach("cut_off.after_entry"),
        }
    }
    std::fs::remove_dir(root)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_else_is_deleted_with_an_evaluation_that_was_cut_off() {
        let temporary = tempfile::tempdir().unwrap();
        let (result, precious) = (temporary.path().join("result"), temporary.path().join("precious"));
        for folder in [&result, &precious] {
            std::fs::create_dir(folder).unwrap();
        }
        std::fs::write(precious.join("file"), "precious").unwrap();
        // Neither what its identity names, nor what a link in its place leads to.
        let mut identity = Identity::new().unwrap();
        identity.begin_incarnation();
        identity.incarnations[0].wire = format!("stillroom_@{}", precious.display());
        identity.write(&RunFolder::new(&result)).unwrap();
        remove_evaluation(&result).unwrap();
        assert!(precious.join("file").is_file() && !result.exists());
        std::os::unix::fs::symlink(&precious, &result).unwrap();
        remove_evaluation(&result).unwrap();
        assert!(precious.join("file").is_file() && !result.is_symlink());
    }
}
