use super::libtorch;
use anyhow::{Result, bail};
use proto::device::Torch;
use rustix::fs::Access;
use std::ffi::OsString;
use std::path::PathBuf;

#[derive(Debug, Clone)]
pub struct Programs {
    pub learner: PathBuf,
    pub actor: PathBuf,
    pub learner_environment: Vec<(OsString, OsString)>,
}

#[derive(Debug, Clone)]
pub struct Tools {
    pub programs: Programs,
    pub torch: Torch,
}

impl Tools {
    pub fn find() -> Result<Self> {
        let learner = find("learner")?;
        let actor = find("actor")?;
        let learner_environment = libtorch::environment()?;
        let torch = libtorch::check(&learner, &learner_environment)?;
        Ok(Self { programs: Programs { learner, actor, learner_environment }, torch })
    }
}

pub fn find(name: &str) -> Result<PathBuf> {
    let beside = std::env::current_exe().ok().and_then(|own| Some(own.parent()?.to_path_buf()));
    let path = std::env::var_os("PATH").unwrap_or_default();
    let folders = beside.iter().cloned().chain(std::env::split_paths(&path));
    if let Some(program) = find_in(name, folders) {
        return Ok(program);
    }
    let place = beside.map_or_else(String::new, |folder| format!(" in {} nor", folder.display()));
    bail!("the program `{name}` is neither{place} on the PATH; `make build` compiles it")
}

pub fn on_path(name: &str) -> Option<PathBuf> {
    find_in(name, std::env::split_paths(&std::env::var_os("PATH").unwrap_or_default()))
}

fn find_in(name: &str, folders: impl Iterator<Item = PathBuf>) -> Option<PathBuf> {
    let is_program = |path: &PathBuf| path.is_file() && rustix::fs::access(path, Access::EXEC_OK).is_ok();
    folders.map(|folder| folder.join(name)).find(is_program)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn the_first_that_can_be_executed_is_taken() {
        let first = tempfile::tempdir().unwrap();
        let second = tempfile::tempdir().unwrap();
        for folder in [&first, &second] {
            std::fs::write(folder.path().join("learner"), "").unwrap();
        }
        let folders = || [first.path().to_path_buf(), second.path().to_path_buf()].into_iter();
        assert_eq!(find_in("learner", folders()), None, "not executable");
        let program = second.path().join("learner");
        std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).unwrap();
        assert_eq!(find_in("learner", folders()), Some(program));
    }

    #[test]
    fn what_is_missing_is_named() {
        let message = find("no-such-stillroom-program").unwrap_err().to_string();
        assert!(message.contains("no-such-stillroom-program") && message.contains("make build"), "{message}");
    }
}
