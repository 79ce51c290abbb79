//! Where a run's kitchens come from: the generator, the scene files that its configuration names, or the procedural
//! kitchens that were kept in its folder.

use crate::kitchen::found_kitchen::{FoundKitchen, FoundKitchenError};
use crate::kitchen::{Kitchen, KitchenError, KitchenKey};
use crate::scene_file::{self, SceneError};
use proto::config::Config;
use proto::kitchen::KitchenId;
use proto::run_folder::RunFolder;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// A kept kitchen has 9 to 14 kB.
const KITCHEN_BYTES_MOST: u64 = 1 << 20;

#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    #[error(transparent)]
    Generated(#[from] KitchenError),
    #[error(transparent)]
    Scene(#[from] SceneError),
    #[error("scene {path}: {cause}", path = .path.display())]
    NotItsOwn { path: PathBuf, cause: std::io::Error },
    #[error(
        "the run's environments are not built in, and are not drawn here: `orchestrator replay RUN` makes films of them"
    )]
    NotBuiltIn,
    #[error("kitchen {kitchen} is scene {index} of the run's list, which has {scenes}")]
    NoScene { kitchen: KitchenId, index: usize, scenes: usize },
}

/// The kitchen with this number in a run with this configuration, whose scene files are named relative to `folder`, its
/// run folder. A procedural kitchen that is kept there is opened; one that is not is made, which takes longer.
pub fn of_run(id: KitchenId, config: &Config, folder: &Path) -> Result<Kitchen, SourceError> {
    if config.environment.is_some() {
        return Err(SourceError::NotBuiltIn);
    }
    if id.is_procedural() {
        let kitchen_key = KitchenKey::new(id, config.kitchens.seed);
        return match kept(kitchen_key, config, folder) {
            Some(found) => Ok(found.open()?),
            None => Ok(Kitchen::generate(kitchen_key, &config.simulation)?),
        };
    }
    let Some(index) = id.scene_index() else { return Ok(Kitchen::build(id, &config.simulation)?) };
    let missing = || SourceError::NoScene { kitchen: id, index, scenes: config.scenes.len() };
    let scene = config.scenes.get(index).ok_or_else(missing)?;
    let path = folder.join(scene);
    // A run folder can come from anybody: its scene is its own copy, no link to a file of ours, whose lines an error shows.
    if !folder.as_os_str().is_empty()
        && let Err(cause) = RunFolder::new(folder).open(&path)
    {
        return Err(SourceError::NotItsOwn { path, cause });
    }
    Ok(scene_file::load(&path, id, &config.simulation)?)
}

/// The same, and a procedural kitchen that had to be made is kept in the folder for the next time. Where it cannot be
/// written, it is made again.
pub fn of_run_and_kept(id: KitchenId, config: &Config, folder: &Path) -> Result<Kitchen, SourceError> {
    if !id.is_procedural() {
        return of_run(id, config, folder);
    }
    let kitchen_key = KitchenKey::new(id, config.kitchens.seed);
    let found = match kept(kitchen_key, config, folder) {
        Some(found) => found,
        None => make_and_keep(kitchen_key, config, folder)?,
    };
    Ok(found.open()?)
}

/// Makes a procedural kitchen and keeps it in the folder, if it is not there; returns whether it was made.
pub fn keep_ready(id: KitchenId, config: &Config, folder: &Path) -> Result<bool, SourceError> {
    let kitchen_key = KitchenKey::new(id, config.kitchens.seed);
    let there = kept(kitchen_key, config, folder).is_some();
    if !there {
        make_and_keep(kitchen_key, config, folder)?;
    }
    Ok(!there)
}

/// What the folder keeps of a kitchen; none where that is missing or cannot be used.
fn kept(kitchen_key: KitchenKey, config: &Config, folder: &Path) -> Option<FoundKitchen> {
    let path = path_of(kitchen_key.id(), folder);
    let bytes = RunFolder::new(folder).read(&path, KITCHEN_BYTES_MOST).ok()?;
    match FoundKitchen::from_bytes(&bytes, kitchen_key, config.simulation) {
        Ok(found) => Some(found),
        Err(problem) => {
            let path = path.display();
            match problem {
                FoundKitchenError::Checksum | FoundKitchenError::Impossible => {
                    tracing::warn!("{path} is damaged and is made anew: {problem}");
                }
                FoundKitchenError::Version | FoundKitchenError::Other => {
                    tracing::debug!("{path} is made anew: {problem}");
                }
            }
            None
        }
    }
}

fn make_and_keep(kitchen_key: KitchenKey, config: &Config, folder: &Path) -> Result<FoundKitchen, SourceError> {
    let found = FoundKitchen::make(kitchen_key, &config.simulation)?;
    let path = path_of(kitchen_key.id(), folder);
    if let Err(error) = write(&path, &found.to_bytes()) {
        tracing::warn!(
            "cannot keep kitchen {} in {}: {error}; it is made again when it is needed",
            kitchen_key.id(),
            path.display()
        );
    }
    Ok(found)
}

fn path_of(id: KitchenId, folder: &Path) -> PathBuf {
    RunFolder::new(folder).kitchens().join(format!("{id}.kitchen"))
}

/// Several actors, or two threads of one, may make one kitchen at the same time: each writes a file of its own, and the
/// last one renamed stays.
///
/// It need not survive a power cut: a file that is not whole is noticed by its checksum.
fn write(path: &Path, content: &[u8]) -> std::io::Result<()> {
    static WRITTEN: AtomicU64 = AtomicU64::new(0);
    let folder = path.parent().unwrap_or(Path::new("."));
    std::fs::create_dir_all(folder)?;
    let number = WRITTEN.fetch_add(1, Ordering::Relaxed);
    let temporary = path.with_extension(format!("{}-{number}.partial", std::process::id()));
    // Made anew, it cannot be a link to a file elsewhere.
    let written = File::create_new(&temporary)
        .and_then(|mut file| file.write_all(content))
        .and_then(|()| std::fs::rename(&temporary, path));
    if written.is_err() {
        // Nothing is left behind on a full disk.
        let _ = std::fs::remove_file(&temporary);
    }
    written
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::config::KitchenSource;

    #[test]
    fn a_kitchen_that_is_kept_is_opened_and_a_damaged_one_is_made_anew() {
        let folder = tempfile::tempdir().unwrap();
        let mut config = Config::default();
        config.kitchens.source = KitchenSource::Procedural;
        config.kitchens.seed = 3;
        let id = KitchenId::new(1001).unwrap();
        let fresh = of_run(id, &config, folder.path()).unwrap();
        let path = path_of(id, folder.path());
        assert!(!path.exists(), "whoever only reads writes nothing");
        let kept = of_run_and_kept(id, &config, folder.path()).unwrap();
        let whole = std::fs::read(&path).unwrap();
        assert!(!keep_ready(id, &config, folder.path()).unwrap());
        std::fs::write(&path, &whole[..whole.len() / 2]).unwrap();
        let mended = of_run_and_kept(id, &config, folder.path()).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), whole);
        for kitchen in [&kept, &mended, &of_run(id, &config, folder.path()).unwrap()] {
            assert_eq!(kitchen.settled_poses(), fresh.settled_poses());
            assert_eq!(kitchen.robot_stands(), fresh.robot_stands());
        }
        // Another seed's kitchen under the same number is another one.
        config.kitchens.seed = 4;
        assert_ne!(of_run(id, &config, folder.path()).unwrap().settled_poses(), fresh.settled_poses());
        std::fs::remove_file(&path).unwrap();
        std::fs::create_dir(&path).unwrap();
        assert!(of_run_and_kept(id, &config, folder.path()).is_ok(), "it can be made though it cannot be kept");
        assert_eq!(std::fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
    }

    #[test]
    fn a_kitchen_is_read_from_an_ordinary_file_and_written_through_no_link() {
        let folder = tempfile::tempdir().unwrap();
        let mut config = Config::default();
        config.kitchens.source = KitchenSource::Procedural;
        let kitchen_key = KitchenKey::new(KitchenId::new(1001).unwrap(), config.kitchens.seed);
        let path = path_of(kitchen_key.id(), folder.path());
        std::fs::create_dir(path.parent().unwrap()).unwrap();
        // To open it would be to wait for ever.
        assert!(std::process::Command::new("mkfifo").arg(&path).status().unwrap().success());
        assert_eq!(kept(kitchen_key, &config, folder.path()), None);
        std::fs::remove_file(&path).unwrap();
        std::fs::File::create(&path).unwrap().set_len(100 << 30).unwrap();
        assert_eq!(kept(kitchen_key, &config, folder.path()), None);

        let precious = folder.path().join("precious");
        std::fs::write(&precious, "precious").unwrap();
        for number in 0..200 {
            let partial = path.with_extension(format!("{}-{number}.partial", std::process::id()));
            std::os::unix::fs::symlink(&precious, partial).unwrap();
        }
        let _ = write(&path, b"a kitchen");
        assert_eq!(std::fs::read_to_string(&precious).unwrap(), "precious");
    }
}
