//! A new run folder, of a run or of an evaluation.

use super::identity::{Identity, is_evaluation};
use super::lock::{Held, RunLock, holder};
use super::scenes;
use anyhow::{Context, Result, bail};
use proto::config::Config;
use proto::run_folder::{RunFolder, write_atomically};
use std::path::PathBuf;

/// Refuses a folder that holds anything.
pub fn check_free(folder: &RunFolder) -> Result<()> {
    let root = folder.root().display();
    match std::fs::read_dir(folder.root()) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(error).with_context(|| format!("run folder {root}")),
        Ok(mut entries) => {
            if entries.next().is_none() {
                return Ok(());
            }
        }
    }
    if let Held::By(holder) = holder(folder)? {
        bail!("run folder {root} is already in use: pid {} on {} runs it", holder.pid, holder.host);
    }
    if folder.identity().exists() && is_evaluation(folder) {
        bail!("folder {root} is already in use: it holds an evaluation");
    }
    if folder.identity().exists() {
        bail!("run folder {root} is already in use: it holds a run, and `orchestrator resume {root}` goes on with it");
    }
    bail!("run folder {root} is not empty, and it is no run: choose another with --run")
}

/// Makes the folder and everything that is in it before the first process starts: these folders, and one for logs.
pub fn create(folder: &RunFolder, config: &mut Config, folders: &[PathBuf]) -> Result<(Identity, RunLock)> {
    let lock = prepare(folder, config, folders)?;
    let identity = Identity::new()?;
    identity.write(folder)?;
    Ok((identity, lock))
}

/// Makes the folder, these folders in it, and everything else but the identity, which makes it a run.
pub fn prepare(folder: &RunFolder, config: &mut Config, folders: &[PathBuf]) -> Result<RunLock> {
    check_free(folder)?;
    for path in [folder.root().to_path_buf(), folder.logs()].iter().chain(folders) {
        std::fs::create_dir_all(path).with_context(|| format!("cannot create {}", path.display()))?;
    }
    let lock = RunLock::acquire(folder)?;
    if folder.identity().exists() {
        bail!("run folder {} is already in use: another orchestrator was faster", folder.root().display());
    }
    scenes::keep(config, folder)?;
    write_atomically(&folder.config(), config.to_toml().as_bytes())
        .with_context(|| format!("cannot write {}", folder.config().display()))?;
    Ok(lock)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_new_or_empty_folder_is_taken() {
        let temporary = tempfile::tempdir().unwrap();
        let mut config = Config::resolve("demo", None).unwrap();
        let new = RunFolder::new(temporary.path().join("a/b"));
        check_free(&new).unwrap();
        let (identity, lock) = create(&new, &mut config, &[]).unwrap();
        assert_eq!(Identity::read(&new).unwrap(), identity);
        let text = std::fs::read_to_string(new.config()).unwrap();
        assert_eq!(Config::from_toml(&text, "config.toml").unwrap(), config);
        let message = check_free(&new).unwrap_err().to_string();
        assert!(message.contains("already in use") && message.contains("resume"), "{message}");
        drop(lock);

        let foreign = RunFolder::new(temporary.path());
        let message = check_free(&foreign).unwrap_err().to_string();
        assert!(message.contains("not empty"), "{message}");
    }
}
