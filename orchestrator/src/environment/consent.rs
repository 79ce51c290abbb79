//! Which commands this user has allowed to simulate environments.
//!
//! A run folder can come from anybody, and its configuration names a program to start. So that program is started only if
//! this user has named it on a command line before, in `orchestrator up --env`, or has allowed it by `orchestrator allow`.
//! The SHA-256 of each such command is a line of a file of this user's.

use anyhow::{Context, Result, bail};
use proto::bounded;
use proto::config::{Config, EnvironmentConfig};
use proto::digest::sha256;
use proto::plain_file::open_plain;
use proto::printable::printable;
use proto::shell::quoted;
use std::fs::OpenOptions;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

const FILE: &str = "stillroom/allowed";

pub fn allow(command: &[String]) -> Result<()> {
    allow_in(&place()?, command)
}

pub fn demand(config: &Config, folder: &Path) -> Result<()> {
    let Some(EnvironmentConfig { command, .. }) = &config.environment else { return Ok(()) };
    if is_allowed_in(&place()?, command)? {
        return Ok(());
    }
    bail!(
        "{run} has its environments simulated by a command that you have not allowed on this machine: {command}; if you \
         trust it: `orchestrator allow {quoted}`",
        run = folder.display(),
        command = shown(command),
        quoted = quoted(folder)
    )
}

pub fn shown(command: &[String]) -> String {
    let words: Vec<String> = command.iter().map(quoted).collect();
    printable(&words.join(" ")).replace('\n', "\\n")
}

fn place() -> Result<PathBuf> {
    let variable = |name| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let states = variable("XDG_STATE_HOME").or_else(|| Some(variable("HOME")?.join(".local/state")));
    Ok(states.context("neither XDG_STATE_HOME nor HOME names a folder, where allowed commands are noted")?.join(FILE))
}

fn allow_in(path: &Path, command: &[String]) -> Result<()> {
    if is_allowed_in(path, command)? {
        return Ok(());
    }
    let noted = || -> std::io::Result<()> {
        std::fs::create_dir_all(path.parent().unwrap_or(Path::new("")))?;
        let mut file = open_plain(path, OpenOptions::new().create(true).append(true))?;
        // One write: two processes may note at the same time.
        file.write_all(format!("{}\n", digest(command)).as_bytes())
    };
    noted().with_context(|| format!("cannot note in {} that the command is allowed", path.display()))
}

fn is_allowed_in(path: &Path, command: &[String]) -> Result<bool> {
    let text = match bounded::read_text(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(false),
        text => text.with_context(|| format!("cannot read {}", path.display()))?,
    };
    let digest = digest(command);
    Ok(text.lines().any(|line| line == digest))
}

/// Of the words, each with its length: no other words have the same bytes.
fn digest(command: &[String]) -> String {
    let words: Vec<String> = command.iter().map(|word| format!("{}:{word}", word.len())).collect();
    sha256(words.concat().as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_was_allowed_is_allowed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("state/allowed");
        let command = |words: &[&str]| words.iter().map(|&word| word.to_owned()).collect::<Vec<_>>();
        let mine = command(&["python3", "-m", "mine"]);
        assert!(!is_allowed_in(&path, &mine).unwrap());
        allow_in(&path, &mine).unwrap();
        allow_in(&path, &mine).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap().lines().count(), 1);
        assert!(is_allowed_in(&path, &mine).unwrap());
        for other in [&["python3", "-m", "mine", "--more"][..], &["python3", "-mmine"], &["python3", "-m mine"]] {
            assert!(!is_allowed_in(&path, &command(other)).unwrap(), "{other:?}");
        }
    }

    #[test]
    fn a_command_is_shown_in_one_line_without_control_characters() {
        let command = ["sh", "-c", "rm -r x\n\u{1b}[2J"].map(str::to_owned);
        let shown = shown(&command);
        assert!(!shown.contains('\n') && !shown.contains('\u{1b}') && shown.starts_with("sh -c "), "{shown}");
    }
}
