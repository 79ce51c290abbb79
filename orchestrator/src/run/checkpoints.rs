//! The checkpoints of a folder: which there are, which is the newest one, and whether it is whole.

use anyhow::{Context, Result, anyhow, ensure};
use proto::bounded;
use proto::checkpoint::Manifest;
use proto::digest::sha256;
use proto::run_folder::{RolloutName, RunFolder};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Reads a manifest, without its tensors.
pub fn read_manifest(path: &Path) -> Result<Manifest> {
    Manifest::read(path).map_err(|error| anyhow!("{} {error}", path.display()))
}

/// The newest checkpoint of a run whose manifest can be read. Its tensors may be damaged, which is not looked at: for a
/// look at a run that somebody works on.
pub fn newest_readable(folder: &RunFolder) -> Result<Option<Manifest>> {
    let manifests = manifests(&folder.checkpoints(), folder.id().as_deref())?;
    Ok(manifests.iter().find_map(|path| Manifest::read(path).ok()))
}

/// The manifest of the newest checkpoint in a folder that is whole, and what is wrong with newer ones: as a learner that
/// goes on chooses. In the folder of a run only its own count.
pub fn newest_whole(folder: &Path, run: Option<&str>) -> Result<(PathBuf, Vec<anyhow::Error>)> {
    let mut damaged = Vec::new();
    for manifest in manifests(folder, run)? {
        match check(&manifest) {
            Ok(()) => return Ok((manifest, damaged)),
            Err(error) => damaged.push(error),
        }
    }
    let error = damaged.into_iter().next();
    Err(match error {
        Some(error) => error.context(format!("no checkpoint in {} is whole", folder.display())),
        None => anyhow!("there is no checkpoint in {}", folder.display()),
    })
}

/// No network's checkpoint is as long.
const TENSORS_MOST: u64 = 1 << 40;

/// Whether a checkpoint is as its manifest says.
fn check(manifest: &Path) -> Result<()> {
    let Manifest { tensors, tensors_bytes, tensors_sha256, .. } = read_manifest(manifest)?;
    let is_beside = Path::new(&tensors).file_name() == Some(tensors.as_ref());
    ensure!(is_beside, "{} names tensors that are not beside it: {tensors}", manifest.display());
    let path = manifest.with_file_name(tensors);
    // The folder can be somebody else's, with a pipe in the place of a file.
    let bytes = bounded::read(&path, tensors_bytes.min(TENSORS_MOST))
        .with_context(|| format!("cannot read {}", path.display()))?;
    ensure!(
        sha256(&bytes) == tensors_sha256,
        "{} is damaged: its SHA-256 is not the one that its manifest names",
        path.display()
    );
    Ok(())
}

/// The manifests in a folder, the highest rollout first; in that of a run, those that are the run's.
fn manifests(folder: &Path, run: Option<&str>) -> Result<Vec<PathBuf>> {
    let entries = match std::fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(error).with_context(|| folder.display().to_string()),
    };
    let foreign =
        |path: &Path| run.is_some_and(|run| Manifest::read(path).is_ok_and(|manifest| manifest.is_of_another(run)));
    let mut found = BTreeMap::new();
    for entry in entries {
        let path = entry.with_context(|| folder.display().to_string())?.path();
        if let Some(rollout) = RolloutName::Manifest.rollout_of(&path)
            && !foreign(&path)
        {
            found.insert(rollout, path);
        }
    }
    Ok(found.into_values().rev().collect())
}

#[cfg(test)]
pub mod tests {
    use super::*;
    use proto::checkpoint::Machine;
    use proto::config::CarriedGoal;

    /// The manifest of a checkpoint whose tensors are the text `tensors K`.
    pub fn manifest(rollout: u64, frames: u64) -> Vec<u8> {
        let machine = Machine {
            torch: "2.11.0".into(),
            device: "cpu".into(),
            threads: 2,
            arithmetic: "avx2".into(),
            learners: 1,
            shards: 0,
        };
        let manifest = Manifest {
            schema_version: proto::SCHEMA_VERSION,
            run: String::new(),
            rollout,
            frames,
            exchange: 0,
            stage: 0,
            stage_end: false,
            adam_steps: 0,
            multiplier: 0.0,
            carried_goal: CarriedGoal::GoalToObject,
            tensors: RolloutName::Tensors.of(rollout),
            tensors_bytes: format!("tensors {rollout}").len() as u64,
            tensors_sha256: sha256(format!("tensors {rollout}").as_bytes()),
            figures_sha256: String::new(),
            config_sha256: String::new(),
            config: String::new(),
            weights: "w".into(),
            machine,
            manifest_sha256: String::new(),
        };
        manifest.seal()
    }

    #[test]
    fn what_is_no_manifest_is_named_with_the_reason() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(RolloutName::Manifest.of(1));
        std::fs::write(&path, manifest(1, 500)).unwrap();
        assert_eq!(read_manifest(&path).unwrap().frames, 500);
        let changed = String::from_utf8(manifest(1, 500)).unwrap().replace("500", "600");
        for (content, reason) in [("torn", "is not a manifest"), (&changed, "does not match its own checksum")] {
            std::fs::write(&path, content).unwrap();
            let error = read_manifest(&path).unwrap_err().to_string();
            assert!(error.starts_with(&format!("{} {reason}", path.display())), "{error}");
        }
    }

    #[test]
    fn the_newest_that_can_be_read_need_not_be_whole() {
        let temporary = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(temporary.path());
        assert!(newest_readable(&folder).unwrap().is_none(), "there is no such folder");
        std::fs::create_dir(folder.checkpoints()).unwrap();
        assert!(newest_readable(&folder).unwrap().is_none());
        for rollout in [1, 12] {
            std::fs::write(folder.checkpoint_manifest(rollout), manifest(rollout, 100 * rollout)).unwrap();
        }
        std::fs::write(folder.checkpoint_manifest(13), "torn").unwrap();
        std::fs::write(folder.checkpoints().join(RolloutName::Tensors.of(1)), "tensors 1").unwrap();
        assert_eq!(newest_readable(&folder).unwrap().unwrap().frames, 1200);
        let (whole, damaged) = newest_whole(&folder.checkpoints(), None).unwrap();
        assert_eq!((whole, damaged.len()), (folder.checkpoint_manifest(1), 2));
    }
}
