//! `actor check --scene`: everything that a scene must satisfy, in one line, and a copy of its files.

use super::kitchens::scene_problems;
use anyhow::{Context, Result};
use proto::config::Config;
use proto::disk::{copy, sync_folder};
use proto::kitchen::{KitchenId, TargetCategory};
use proto::likeness::likeness;
use simulator::kitchen::Kitchen;
use simulator::kitchen::catalogue::CATEGORIES;
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
    // A run has its scenes judged first, and copied then.
    let is_asked = copy.is_none() && !targets_only;
    for (thing, target) in nearly_targets(&kitchen).into_iter().filter(|_| is_asked) {
        eprintln!(
            "{}: {thing} is no target, did you mean `{target}`? Add category = \"{target}\" to its entry",
            path.display()
        );
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

/// So much alike are a target's name and one that was probably meant to be it, of as many letters or one more or less.
const NEARLY: f64 = 0.88;

/// Movable things that are nearly called like a target, and are of no other category, with that target.
fn nearly_targets(kitchen: &Kitchen) -> Vec<(&str, &'static str)> {
    let near = |name: &str| {
        let targets = TargetCategory::ALL.into_iter().map(TargetCategory::name);
        let is_known =
            CATEGORIES.iter().any(|category| category.name == name) || targets.clone().any(|one| one == name);
        let is_near = |target: &str| name.len().abs_diff(target.len()) < 2 && likeness(name, target) > NEARLY;
        targets
            .filter(|target| !is_known && is_near(target))
            .max_by(|a, b| likeness(name, a).total_cmp(&likeness(name, b)))
    };
    let things = &kitchen.bodies()[kitchen.movable_bodies()];
    things.iter().filter_map(|thing| Some((thing.name.as_str(), near(&thing.category)?))).collect()
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thing_that_is_nearly_called_like_a_target_is_named_with_it() {
        let studio = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes/studio");
        let folder = tempfile::tempdir().unwrap();
        let mut glb = std::fs::read(studio.join("studio.glb")).unwrap();
        let places: Vec<usize> = (0..glb.len() - 5).filter(|&at| glb[at..].starts_with(b"Apple")).collect();
        for &at in &places {
            glb[at..at + 5].copy_from_slice(b"Appel");
        }
        std::fs::write(folder.path().join("studio.glb"), glb).unwrap();
        let text = std::fs::read_to_string(studio.join("scene.toml")).unwrap().replace("\"Apple\"", "\"Appel\"");
        std::fs::write(folder.path().join("scene.toml"), text).unwrap();
        let kitchen = |folder: &Path| {
            load(&folder.join("scene.toml"), KitchenId::scene(0).unwrap(), &Config::default().simulation).unwrap()
        };
        assert_eq!(nearly_targets(&kitchen(folder.path())), [("Appel", "Apple")]);
        assert_eq!(nearly_targets(&kitchen(&studio)), []);
    }
}
