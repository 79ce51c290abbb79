use super::identity::{Identity, is_evaluation};
use super::lock::{LockState, RunLock, holder};
use super::scenes;
use super::unfinished::{clear, is_cut_off};
use crate::preflight::temporary;
use crate::wrong::reject;
use anyhow::{Context, Result, bail};
use proto::config::Config;
use proto::run_folder::{RunFolder, write_atomically};
use proto::shell::quoted;
use std::path::{Path, PathBuf};
use wire::fault;

/// Refuses a folder that holds anything. Where the making of a run was cut off there is nothing to lose: such a folder is
/// as good as empty.
pub fn check_free(folder: &RunFolder) -> Result<()> {
    let root = folder.root().display();
    match std::fs::read_dir(folder.root()) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        Err(error) if error.kind() == std::io::ErrorKind::NotADirectory => {
            reject!("{root} is a file, or below one: choose another folder")
        }
        Err(error) => return Err(error).with_context(|| format!("run folder {root}")),
        Ok(mut entries) => {
            if entries.next().is_none() {
                return Ok(());
            }
        }
    }
    match holder(folder)? {
        LockState::By(holder) => bail!("run folder {root} is already in use: {holder} runs it"),
        LockState::Unsigned if !folder.identity().exists() => {
            bail!("run folder {root} is already in use: another orchestrator begins in it")
        }
        LockState::Unsigned | LockState::Free => {}
    }
    if is_cut_off(folder).with_context(|| format!("run folder {root}"))? {
        return Ok(());
    }
    if folder.identity().exists() && is_evaluation(folder) {
        reject!("folder {root} is already in use: it holds an evaluation; choose another folder");
    }
    if folder.identity().exists() {
        let run = quoted(folder.root());
        reject!(
            "run folder {root} is already in use: it holds a run, and `orchestrator resume {run}` goes on with it; for \
             another run choose another folder"
        );
    }
    reject!("run folder {root} is not empty, and it is no run: choose another folder")
}

const NAMESAKES_MOST: u32 = 10_000;

/// Makes a folder of this name, or where there is one with a number behind it: names that are made of the time are taken by
/// whoever begins in the same second.
pub fn new_folder(name: &Path) -> Result<RunFolder> {
    let parent = name.parent().unwrap_or(Path::new(""));
    std::fs::create_dir_all(parent).with_context(|| format!("cannot create {}", parent.display()))?;
    for number in 1..NAMESAKES_MOST {
        let mut path = name.as_os_str().to_owned();
        if number > 1 {
            path.push(format!("-{number}"));
        }
        match std::fs::create_dir(&path) {
            Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {}
            made => {
                return made
                    .map(|()| RunFolder::new(path))
                    .with_context(|| format!("cannot create {}", name.display()));
            }
        }
    }
    bail!("there are {NAMESAKES_MOST} folders called {}: name another", name.display())
}

/// Makes the folder and everything that is in it before the first process starts: these folders, and one for logs.
pub fn create(folder: &RunFolder, config: &mut Config, folders: &[PathBuf]) -> Result<(Identity, RunLock)> {
    let lock = prepare(folder, config, folders)?;
    let identity = Identity::new()?;
    fault::reach("create.before_identity");
    identity.write(folder)?;
    fault::reach("create.after_identity");
    Ok((identity, lock))
}

/// Makes the folder, these folders in it, and everything else but the identity, which makes it a run.
pub fn prepare(folder: &RunFolder, config: &mut Config, folders: &[PathBuf]) -> Result<RunLock> {
    check_free(folder)?;
    // All ids are of one length.
    temporary::check_name(&Identity::new()?.id)?;
    for path in [folder.root().to_path_buf(), folder.logs()].iter().chain(folders) {
        std::fs::create_dir_all(path).with_context(|| format!("cannot create {}", path.display()))?;
        fault::reach("create.after_folder");
    }
    let lock = RunLock::acquire(folder)?;
    fault::reach("create.after_lock");
    // Looked at again now that nobody else can begin in it.
    if !is_cut_off(folder).with_context(|| format!("run folder {}", folder.root().display()))? {
        bail!("run folder {} is already in use: another orchestrator was faster", folder.root().display());
    }
    clear(folder).with_context(|| format!("cannot clear {}", folder.root().display()))?;
    scenes::keep(config, folder)?;
    write_atomically(&folder.task(), config.spec().text().as_bytes())
        .with_context(|| format!("cannot write {}", folder.task().display()))?;
    fault::reach("create.before_config");
    write_atomically(&folder.config(), config.to_toml().as_bytes())
        .with_context(|| format!("cannot write {}", folder.config().display()))?;
    Ok(lock)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_that_is_being_made_is_taken_by_nobody_else() {
        let temporary = tempfile::tempdir().unwrap();
        let mut config = Config::resolve("demo", None).unwrap();
        let begun = RunFolder::new(temporary.path().join("a/b"));
        let lock = prepare(&begun, &mut config, &[]).unwrap();
        let message = check_free(&begun).unwrap_err().to_string();
        assert!(message.contains("another orchestrator begins in it"), "{message}");
        drop(lock);
        check_free(&begun).unwrap();
    }
}
