//! A run's own scenes: checked before it begins, and copied into its folder, so that it can be resumed and replayed
//! whatever becomes of the originals.
//!
//! This program links no physics: `actor check --scene` reads and judges them.

use crate::output::format::counted;
use crate::output::log_line::error_in;
use crate::output::terminal;
use crate::preflight::{Finding, programs};
use crate::process_end::{self, Answer};
use crate::wrong::judged;
use anyhow::{Context, Result, bail, ensure};
use proto::bounded;
use proto::config::Config;
use proto::digest::Digest256;
use proto::kitchen::TargetCategory;
use proto::run_folder::{Item, RunFolder, unlike_a_flag};
use std::ffi::OsStr;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

pub fn check(config: &Config) -> Result<()> {
    if config.scenes.is_empty() {
        return Ok(());
    }
    judged(finding(config, &programs::find("actor")?).map_or(Ok(()), Finding::demand))
}

pub fn finding(config: &Config, program: &Path) -> Option<Finding> {
    if config.scenes.is_empty() {
        return None;
    }
    let judged = config.scenes.iter().map(|scene| ask(program, Path::new(scene), &[]));
    let problems: Vec<String> = judged.filter_map(|found| Some(format!("{:#}", found.err()?))).collect();
    Some(if problems.is_empty() {
        Finding::Good(format!("{}: {}", counted(config.scenes.len() as u64, "scene"), config.scenes.join(", ")))
    } else {
        Finding::Problem(problems.join("; "))
    })
}

pub fn keep(config: &mut Config, folder: &RunFolder) -> Result<()> {
    if config.scenes.is_empty() {
        return Ok(());
    }
    let program = programs::find("actor")?;
    for (index, scene) in config.scenes.iter_mut().enumerate() {
        let name = Path::new(scene.as_str()).file_name().and_then(|name| name.to_str());
        let name = name.with_context(|| format!("{scene} is not the name of a scene file"))?.to_owned();
        ask(&program, Path::new(scene.as_str()), &[OsStr::new("--copy"), folder.scene(index).as_os_str()])?;
        *scene = format!("{}/{name}", folder.relative_scene(index));
    }
    Ok(())
}

pub fn targets(config: &Config) -> Result<Vec<Vec<TargetCategory>>> {
    if config.scenes.is_empty() {
        return Ok(Vec::new());
    }
    let program = programs::find("actor")?;
    let of = |scene: &String| {
        let said = ask(&program, Path::new(scene), &[OsStr::new("--targets")])?;
        let named = |line: &str| TargetCategory::ALL.into_iter().find(|target| target.name() == line.trim());
        Ok(said.lines().filter_map(named).collect())
    };
    config.scenes.iter().map(of).collect()
}

const FILE_BYTES_MOST: u64 = 512 << 20;
const FILES_MOST: usize = 10_000;

const ALL_BYTES_MOST: u64 = 2 << 30;

pub fn files_below(run: &RunFolder, root: &Path, folder: &Path) -> Result<Vec<(String, Vec<u8>)>> {
    let (mut waiting, mut found, mut bytes) = (vec![folder.to_owned()], Vec::new(), 0);
    while let Some(folder) = waiting.pop() {
        for Item { path, is_folder, .. } in run.list(&folder)? {
            if is_folder {
                waiting.push(path);
                continue;
            }
            let name = path.strip_prefix(root)?.to_str().context("a name that is not text")?.to_owned();
            let content = run.read(&path, FILE_BYTES_MOST).with_context(|| name.clone())?;
            bytes += content.len() as u64;
            ensure!(bytes <= ALL_BYTES_MOST, "its files have more than {ALL_BYTES_MOST} bytes together");
            found.push((path, name, content));
        }
        ensure!(waiting.len() + found.len() <= FILES_MOST, "it has more than {FILES_MOST} files and folders");
    }
    found.sort_by(|(a, ..), (b, ..)| a.cmp(b));
    Ok(found.into_iter().map(|(_, name, content)| (name, content)).collect())
}

/// The configuration in a run's folder, with its scenes named by what they hold, too: in every run folder they have the
/// same names.
pub fn config_by_content(folder: &RunFolder) -> Result<Config> {
    let mut config = Config::of_run(folder)?;
    for (index, scene) in config.scenes.iter_mut().enumerate() {
        let files = files_below(folder, &folder.scene(index), &folder.scene(index)).with_context(|| scene.clone())?;
        // Where the copies are gone the name is all that there is.
        if !files.is_empty() {
            let mut digest = Digest256::default();
            for (name, bytes) in files {
                digest.add(format!("{name} {} ", bytes.len()).as_bytes());
                digest.add(&bytes);
            }
            *scene = format!("{scene} (sha256 {})", &digest.finish()[..16]);
        }
    }
    Ok(config)
}

/// What of a configuration's scenes is not as the run in this folder has copied it. An original that is gone says
/// nothing.
pub fn changes(config: &Config, begun: &Config, folder: &RunFolder) -> Result<Vec<String>> {
    if config.scenes.len() != begun.scenes.len() {
        return Ok(vec![counted(begun.scenes.len() as u64, "scene")]);
    }
    let mut changes = Vec::new();
    for (index, scene) in config.scenes.iter().enumerate() {
        if !Path::new(scene).exists() {
            continue;
        }
        let beside = Path::new(scene).parent().unwrap_or(Path::new(""));
        for (name, copied) in
            files_below(folder, &folder.scene(index), &folder.scene(index)).with_context(|| scene.clone())?
        {
            let original = beside.join(name);
            if bounded::read(&original, FILE_BYTES_MOST).ok().as_ref() != Some(&copied) {
                changes.push(format!("another {}", original.display()));
            }
        }
    }
    Ok(changes)
}

/// A sound scene is judged in seconds, a large one with meshes to decompose in some more.
const PATIENCE: Duration = Duration::from_mins(3);

/// Has the actor judge a scene, and do what `further` asks if it is sound; returns what it prints. What it complains of
/// is the error.
fn ask(program: &Path, scene: &Path, further: &[&OsStr]) -> Result<String> {
    ask_within(program, scene, further, PATIENCE)
}

fn ask_within(program: &Path, scene: &Path, further: &[&OsStr], patience: Duration) -> Result<String> {
    let mut command = Command::new(program);
    command.args(["check", "--scene"]).arg(unlike_a_flag(scene)).args(further);
    let answer = process_end::ask(&mut command, patience);
    let answer = answer.with_context(|| format!("scene {} cannot be used", scene.display()))?;
    let Some(Answer { status, stdout, stderr }) = answer else {
        bail!(
            "scene {} cannot be used: it was not judged within {} s; simplify its meshes, or take some out",
            scene.display(),
            patience.as_secs()
        );
    };
    let said = stderr.trim_end();
    if !status.success() {
        let complaint = error_in(said).filter(|error| !error.is_empty()).unwrap_or(said);
        let complaint = complaint.strip_prefix("error: ").unwrap_or(complaint);
        let complaint = if complaint.is_empty() { status.to_string() } else { complaint.to_owned() };
        let named = format!("{}: ", scene.display());
        bail!("scene {} cannot be used: {}", scene.display(), complaint.strip_prefix(&named).unwrap_or(&complaint));
    }
    if !said.is_empty() {
        terminal::note(said);
    }
    Ok(stdout)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn a_scene_that_is_judged_for_ever_is_given_up() {
        let temporary = tempfile::tempdir().unwrap();
        let actor = temporary.path().join("actor");
        std::fs::write(&actor, "#!/bin/sh\nexec sleep 60\n").unwrap();
        std::fs::set_permissions(&actor, std::fs::Permissions::from_mode(0o755)).unwrap();
        let began = std::time::Instant::now();
        let asked = ask_within(&actor, Path::new("slow.toml"), &[], Duration::from_millis(300));
        let message = asked.unwrap_err().to_string();
        assert!(message.contains("slow.toml cannot be used: it was not judged within"), "{message}");
        assert!(began.elapsed() < Duration::from_secs(30));
    }

    #[test]
    fn every_scene_that_cannot_be_used_is_named_with_what_is_wrong_with_it() {
        let temporary = tempfile::tempdir().unwrap();
        let actor = temporary.path().join("actor");
        let script = "#!/bin/sh\ncase $3 in good*) exit 0;; esac\n\
                      echo \"2026-11-21T20:20:25.9Z ERROR $3: line 1: unknown field\" >&2\nexit 1\n";
        std::fs::write(&actor, script).unwrap();
        std::fs::set_permissions(&actor, std::fs::Permissions::from_mode(0o755)).unwrap();
        let found = |scenes: &[&str]| {
            let scenes = scenes.iter().map(|&scene| scene.to_owned()).collect();
            finding(&Config { scenes, ..Config::default() }, &actor)
        };
        assert_eq!(found(&[]), None);
        assert_eq!(found(&["good/a.toml"]), Some(Finding::Good("1 scene: good/a.toml".into())));
        let Some(Finding::Problem(text)) = found(&["bad.toml", "good/a.toml", "worse.toml"]) else { panic!("two") };
        let one = |name: &str| format!("scene {name} cannot be used: line 1: unknown field");
        assert_eq!(text, format!("{}; {}", one("bad.toml"), one("worse.toml")));
    }
}
