//! Checks with `learner check` whether the learner finds a usable libtorch.
//!
//! The library that the programs were built with is found by itself. `LIBTORCH` names another one, for example a torch
//! with CUDA: its `lib` folder then comes first for the learner.

use crate::output::log_line::error_in;
use crate::process_end::{Answer, ask};
use anyhow::{Context, Result, bail};
use proto::device::Torch;
use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

const SERIES: &str = "2.11";
/// Loading libtorch takes half a second from a warm cache; a cold network file system may take a minute.
const PATIENCE: Duration = Duration::from_mins(2);

/// What to type for a libtorch: the Python package has an extra, an archive its own script beside the programs, a checkout a
/// target of its Makefile.
fn set_up() -> String {
    let own = std::env::current_exe().ok();
    set_up_beside(own.as_deref().and_then(Path::parent))
}

fn set_up_beside(programs: Option<&Path>) -> String {
    let beside = |name| programs.map(|folder| folder.join(name)).filter(|path| path.is_file());
    match beside("setup") {
        Some(script) => script.display().to_string(),
        None if beside("__init__.py").is_some() => "pip install 'stillroom[train]'".to_owned(),
        None => "make setup".to_owned(),
    }
}

/// Variables that make the learner find the libtorch that `LIBTORCH` names, if it names one. Errors if that is none or
/// of another series.
pub fn environment() -> Result<Vec<(OsString, OsString)>> {
    match std::env::var_os("LIBTORCH").filter(|value| !value.is_empty()) {
        None => Ok(vec![]),
        Some(root) => environment_for(Path::new(&root), std::env::var_os("LD_LIBRARY_PATH").as_deref()),
    }
}

fn environment_for(root: &Path, before: Option<&OsStr>) -> Result<Vec<(OsString, OsString)>> {
    let lib = root.join("lib");
    if !lib.join("libtorch_cpu.so").exists() {
        bail!(
            "LIBTORCH={} is not a libtorch: {} is missing. Unset it to use the one that `{}` fetches, or point it at \
             the folder of a torch {SERIES} (the one that holds lib/ and include/)",
            root.display(),
            lib.join("libtorch_cpu.so").display(),
            set_up()
        );
    }
    if let Some(version) = version_of(root)
        && !is_of_series(&version)
    {
        bail!(
            "LIBTORCH={} is torch {version}, but this program needs torch {SERIES}.x. Unset LIBTORCH to use the one \
             that `{}` fetches, or point it at a torch {SERIES}",
            root.display(),
            set_up()
        );
    }
    let mut folders = vec![lib];
    folders.extend(before.into_iter().flat_map(std::env::split_paths).filter(|folder| !folder.as_os_str().is_empty()));
    let joined = std::env::join_paths(folders).context("LIBTORCH and LD_LIBRARY_PATH")?;
    Ok(vec![("LD_LIBRARY_PATH".into(), joined)])
}

fn version_of(root: &Path) -> Option<String> {
    if let Ok(text) = std::fs::read_to_string(root.join("build-version")) {
        return Some(text.trim().to_owned()).filter(|version| !version.is_empty());
    }
    let text = std::fs::read_to_string(root.join("version.py")).ok()?;
    let line = text.lines().find(|line| line.starts_with("__version__"))?;
    line.split(['\'', '"']).nth(1).map(str::to_owned)
}

fn is_of_series(version: &str) -> bool {
    version.strip_prefix(SERIES).is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '+']))
}

pub fn check(learner: &Path, environment: &[(OsString, OsString)]) -> Result<Torch> {
    let mut command = Command::new(learner);
    command.arg("check").envs(environment.iter().map(|(name, value)| (name, value)));
    let Some(Answer { status, stdout, stderr }) = ask(&mut command, PATIENCE)? else {
        bail!("`{} check` did not answer within {} s", learner.display(), PATIENCE.as_secs());
    };
    if !status.success() {
        bail!("{}", explain(learner, &status.to_string(), &stderr));
    }
    let line = stdout.lines().last().unwrap_or_default();
    serde_json::from_str(line).with_context(|| format!("`{} check` printed: {stdout}{stderr}", learner.display()))
}

fn explain(learner: &Path, status: &str, complaint: &str) -> String {
    const MISSING: &str = "error while loading shared libraries: ";
    let complaint = complaint.trim();
    if let Some((_, rest)) = complaint.split_once(MISSING) {
        let library: PathBuf = rest.split(':').next().unwrap_or(rest).trim().into();
        return format!(
            "there is no libtorch: {} cannot load {}. Run `{}`, which fetches torch {SERIES}, or set \
             LIBTORCH to the folder of a torch {SERIES} that is already on this machine (the one that holds lib/ and \
             include/)",
            learner.display(),
            library.display(),
            set_up()
        );
    }
    if complaint.contains("symbol lookup error") || complaint.contains("undefined symbol") {
        return format!(
            "the libtorch that {} finds is of another version than {SERIES}: {complaint}. Run `{}`, or set LIBTORCH \
             to the folder of a torch {SERIES}",
            learner.display(),
            set_up()
        );
    }
    let said = complaint.lines().last().and_then(error_in).unwrap_or(complaint);
    let said = if said.is_empty() { status } else { said };
    format!(
        "libtorch does not work: {said}. `{}` fetches torch {SERIES}; LIBTORCH names one that is already there",
        set_up()
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    fn torch(version_file: &str, content: &str) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("lib")).unwrap();
        std::fs::write(folder.path().join("lib/libtorch_cpu.so"), "").unwrap();
        std::fs::write(folder.path().join(version_file), content).unwrap();
        folder
    }

    #[test]
    fn the_right_one_comes_first_on_the_library_path() {
        let python = torch("version.py", "__version__ = '2.11.0+cu130'\ndebug = False\n");
        let environment = environment_for(python.path(), Some(OsStr::new("/usr/lib:/opt/lib"))).unwrap();
        let expected = format!("{}:/usr/lib:/opt/lib", python.path().join("lib").display());
        assert_eq!(environment, [("LD_LIBRARY_PATH".into(), expected.into())]);
        let empty = tempfile::tempdir().unwrap();
        let message = environment_for(empty.path(), None).unwrap_err().to_string();
        assert!(message.contains("is not a libtorch") && message.contains("make setup"), "{message}");
    }

    #[test]
    fn a_release_names_what_comes_with_it() {
        let release = tempfile::tempdir().unwrap();
        assert_eq!(set_up_beside(Some(release.path())), "make setup");
        std::fs::write(release.path().join("__init__.py"), "").unwrap();
        assert_eq!(set_up_beside(Some(release.path())), "pip install 'stillroom[train]'");
        let script = release.path().join("setup");
        std::fs::write(&script, "").unwrap();
        assert_eq!(set_up_beside(Some(release.path())), script.display().to_string());
    }

    fn learner(script: &str) -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("learner");
        std::fs::write(&path, format!("#!/bin/sh\n{script}\n")).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
        (folder, path)
    }

    #[test]
    fn what_keeps_it_from_answering_is_explained() {
        let line = "learner: error while loading shared libraries: libtorch_cpu.so: cannot open shared object file";
        let (_folder, path) = learner(&format!("echo '{line}' >&2; exit 127"));
        let message = check(&path, &[]).unwrap_err().to_string();
        for part in ["there is no libtorch", "libtorch_cpu.so", "make setup", "LIBTORCH"] {
            assert!(message.contains(part), "{part}: {message}");
        }
        let line = "2026-11-21T02:04:23.1Z ERROR libtorch 2.6.0 is loaded from /x; this program needs 2.11.0";
        let (_folder, path) = learner(&format!("echo '{line}' >&2; exit 1"));
        let message = check(&path, &[]).unwrap_err().to_string();
        assert!(message.starts_with("libtorch does not work: libtorch 2.6.0 is loaded"), "{message}");
    }
}
