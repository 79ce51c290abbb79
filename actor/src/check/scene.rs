//! `actor check --scene`: everything that a scene must satisfy, in one line, and a copy of its files.

use super::kitchens::scene_problems;
use anyhow::{Context, Result};
use proto::config::Config;
use proto::disk::{copy, sync_folder};
use proto::kitchen::{KitchenId, TargetCategory};
use simulator::scene_file::{Problem, SceneError, load, read};
use std::collections::BTreeSet;
use std::io::Write;
use std::path::Path;
use std::sync::Arc;

/// Loads a scene, proves that nothing in it moves by itself, and says what it offers. With `copy`, its files are
/// copied into that folder, which is made. With `targets_only` it says the categories of its targets alone, one a line.
pub fn run(path: &Path, copy: Option<&Path>, targets_only: bool, mut out: impl Write) -> Result<()> {
    let config = Config::default();
    let id = KitchenId::scene(0).context("there is a first scene")?;
    let kitchen = Arc::new(load(path, id, &config.simulation)?);
    let found = scene_problems(&kitchen, &config).into_iter();
    let problems: Vec<Problem> = found.map(|problem| Problem::Unfit(problem.to_string())).collect();
    if !problems.is_empty() {
        return Err(SceneError { file: path.to_path_buf(), problems }.into());
    }
    let targets = TargetCategory::ALL.into_iter().filter(|&target| !kitchen.target_spots(target).is_empty());
    if targets_only {
        targets.map(TargetCategory::name).try_for_each(|target| writeln!(out, "{target}"))?;
    } else {
        let targets: Vec<String> =
            targets.map(|target| format!("{} {}", target.name(), kitchen.target_spots(target).len())).collect();
        writeln!(
            out,
            "{}: {} things, at rest; {} robot poses; places of targets: {}",
            path.display(),
            kitchen.thing_count(),
            kitchen.robot_stands().len(),
            targets.join(", ")
        )?;
    }
    copy.map_or(Ok(()), |folder| keep(path, folder))
}

/// Copies a scene's files into a folder. They are on the disk when it returns: a run that a power failure ends is resumed
/// with them.
fn keep(path: &Path, folder: &Path) -> Result<()> {
    let from = path.parent().unwrap_or(Path::new(""));
    let above = folder.parent().map(|above| if above.as_os_str().is_empty() { Path::new(".") } else { above });
    let mut folders = BTreeSet::from([folder, above.unwrap_or(folder)].map(Path::to_owned));
    for file in read(path)?.files {
        let to = folder.join(&file);
        let problem = || format!("cannot copy {} to {}", from.join(&file).display(), to.display());
        let holder = to.parent().unwrap_or(folder);
        std::fs::create_dir_all(holder).with_context(problem)?;
        copy(&from.join(&file), &to).with_context(problem)?;
        folders.extend(holder.ancestors().take_while(|inner| inner.starts_with(folder)).map(Path::to_owned));
    }
    folders
        .iter()
        .try_for_each(|folder| sync_folder(folder).with_context(|| format!("cannot sync {}", folder.display())))
}
