//! A run's own scenes: checked before it begins, and copied into its folder, so that it can be resumed and replayed
//! whatever becomes of the originals.
//!
//! This program links no physics: `actor check --scene` reads and judges them.

use crate::preflight::programs;
use anyhow::{Context, Result, ensure};
use proto::config::Config;
use proto::run_folder::RunFolder;
use std::path::Path;
use std::process::{Command, Stdio};

/// Has every scene of the configuration checked; the actor's complaints go to the terminal.
pub fn check(config: &Config) -> Result<()> {
    config.scenes.iter().try_for_each(|scene| ask(Path::new(scene), None))
}

/// Copies every scene into the run folder and names the copies in the configuration.
pub fn keep(config: &mut Config, folder: &RunFolder) -> Result<()> {
    for (index, scene) in config.scenes.iter_mut().enumerate() {
        let name = Path::new(scene.as_str()).file_name().and_then(|name| name.to_str());
        let name = name.with_context(|| format!("{scene} is not the name of a scene file"))?.to_owned();
        ask(Path::new(scene.as_str()), Some(&folder.scene(index)))?;
        *scene = format!("{}/{name}", folder.relative_scene(index));
    }
    Ok(())
}

fn ask(scene: &Path, copy: Option<&Path>) -> Result<()> {
    let program = programs::find("actor")?;
    let mut command = Command::new(&program);
    command.arg("check").arg("--scene").arg(scene);
    if let Some(copy) = copy {
        command.arg("--copy").arg(copy);
    }
    let status = command
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .status()
        .with_context(|| format!("cannot start {}", program.display()))?;
    ensure!(status.success(), "scene {} cannot be used; what is wrong stands above", scene.display());
    Ok(())
}
