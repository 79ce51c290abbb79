use anyhow::{Context, Result, anyhow, ensure};
use proto::checkpoint::Manifest;
use proto::digest::Digest256;
use proto::disk::TENSORS_BYTES_MOST;
use proto::run_folder::{Item, RolloutName, RunFolder};
use std::collections::BTreeMap;
use std::io::BufRead;
use std::path::{Path, PathBuf};

pub fn read_manifest(folder: &RunFolder, path: &Path) -> Result<Manifest> {
    Manifest::read_in(folder, path).map_err(|error| anyhow!("{} {error}", path.display()))
}

/// By it one sees whether a run has another newest checkpoint than before.
pub fn newest_path(folder: &RunFolder) -> Option<PathBuf> {
    manifests(folder, &folder.checkpoints()).ok()?.into_iter().next()
}

/// The newest checkpoint of a run whose manifest can be read, and what is wrong with newer ones. Its tensors may be
/// damaged, which is not looked at: for a look at a run that somebody works on.
pub fn newest_readable(folder: &RunFolder) -> Result<(Option<Manifest>, Vec<anyhow::Error>)> {
    let (run, mut damaged) = (folder.id(), Vec::new());
    for path in manifests(folder, &folder.checkpoints())? {
        match read_manifest(folder, &path) {
            Ok(manifest) if run.as_ref().is_some_and(|run| manifest.is_of_another(run)) => {}
            Ok(manifest) => return Ok((Some(manifest), damaged)),
            Err(error) => damaged.push(error),
        }
    }
    Ok((None, damaged))
}

/// The manifest of the newest whole checkpoint at this place in a run folder, and what is wrong with newer ones: as a
/// learner that goes on chooses. In the folder of a run only its own count.
pub fn newest_whole(folder: &RunFolder, place: &Path) -> Result<(PathBuf, Vec<anyhow::Error>)> {
    let (run, mut damaged) = (folder.id(), Vec::new());
    for path in manifests(folder, place)? {
        match read_manifest(folder, &path) {
            Ok(manifest) if run.as_ref().is_some_and(|run| manifest.is_of_another(run)) => {}
            Ok(manifest) => match check(folder, &path, manifest) {
                Ok(()) => return Ok((path, damaged)),
                Err(error) => damaged.push(error),
            },
            Err(error) => damaged.push(error),
        }
    }
    let error = damaged.into_iter().next();
    Err(match error {
        Some(error) => error.context(format!("no checkpoint in {} is whole", place.display())),
        None => anyhow!("there is no checkpoint in {}", place.display()),
    })
}

const CHECKPOINTS_MOST: usize = 100;

fn check(folder: &RunFolder, path: &Path, manifest: Manifest) -> Result<()> {
    let Manifest { tensors, tensors_bytes, tensors_sha256, .. } = manifest;
    let is_beside = Path::new(&tensors).file_name() == Some(tensors.as_ref());
    ensure!(is_beside, "{} names tensors that are not beside it: {tensors}", path.display());
    let path = path.with_file_name(tensors);
    let cannot = || format!("cannot read {}", path.display());
    let mut file = folder.reader(&path, tensors_bytes.min(TENSORS_BYTES_MOST)).with_context(cannot)?;
    let mut digest = Digest256::default();
    loop {
        let bytes = file.fill_buf().with_context(cannot)?;
        let count = bytes.len();
        if count == 0 {
            break;
        }
        digest.add(bytes);
        file.consume(count);
    }
    ensure!(
        digest.finish() == tensors_sha256,
        "{} is damaged: its SHA-256 is not the one that its manifest names",
        path.display()
    );
    Ok(())
}

fn manifests(folder: &RunFolder, place: &Path) -> Result<Vec<PathBuf>> {
    let items = folder.list(place).with_context(|| place.display().to_string())?;
    let named = |item: Item| Some((RolloutName::Manifest.rollout_of(&item.path)?, item.path));
    let found: BTreeMap<u64, PathBuf> = items.into_iter().filter_map(named).collect();
    Ok(found.into_values().rev().take(CHECKPOINTS_MOST).collect())
}

#[cfg(test)]
pub mod tests {
    use super::*;
    use proto::digest::sha256;

    /// The manifest of a checkpoint whose tensors are the text `tensors K`.
    pub fn manifest(rollout: u64, frames: u64) -> Vec<u8> {
        let manifest = Manifest {
            schema_version: proto::SCHEMA_VERSION,
            rollout,
            frames,
            tensors: RolloutName::Tensors.of(rollout),
            tensors_bytes: format!("tensors {rollout}").len() as u64,
            tensors_sha256: sha256(format!("tensors {rollout}").as_bytes()),
            weights: "w".into(),
            ..Manifest::default()
        };
        manifest.seal()
    }

    #[test]
    fn what_is_no_manifest_is_named_with_the_reason() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(RolloutName::Manifest.of(1));
        std::fs::write(&path, manifest(1, 500)).unwrap();
        assert_eq!(read_manifest(&RunFolder::new(folder.path()), &path).unwrap().frames, 500);
        let changed = String::from_utf8(manifest(1, 500)).unwrap().replace("500", "600");
        for (content, reason) in [("torn", "is not a manifest"), (&changed, "does not match its own checksum")] {
            std::fs::write(&path, content).unwrap();
            let error = read_manifest(&RunFolder::new(folder.path()), &path).unwrap_err().to_string();
            assert!(error.starts_with(&format!("{} {reason}", path.display())), "{error}");
        }
    }

    #[test]
    fn the_newest_that_can_be_read_need_not_be_whole() {
        let temporary = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(temporary.path());
        assert!(newest_readable(&folder).unwrap().0.is_none(), "there is no such folder");
        std::fs::create_dir(folder.checkpoints()).unwrap();
        assert!(newest_readable(&folder).unwrap().0.is_none());
        for rollout in [1, 12] {
            std::fs::write(folder.checkpoint_manifest(rollout), manifest(rollout, 100 * rollout)).unwrap();
        }
        std::fs::write(folder.checkpoint_manifest(13), "torn").unwrap();
        std::fs::write(folder.checkpoints().join(RolloutName::Tensors.of(1)), "tensors 1").unwrap();
        let (newest, damaged) = newest_readable(&folder).unwrap();
        assert_eq!((newest.unwrap().frames, damaged.len()), (1200, 1));
        let (whole, damaged) = newest_whole(&folder, &folder.checkpoints()).unwrap();
        assert_eq!((whole, damaged.len()), (folder.checkpoint_manifest(1), 2));
    }
}
