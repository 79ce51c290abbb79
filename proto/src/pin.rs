//! Checkpoints that wait for their evaluation are pinned: kept in `RUN/validation/rollout-K/` by hard links, whatever
//! is pruned. The learner pins each before it goes on; the orchestrator lets go of those that are not the best.

use crate::checkpoint::Manifest;
use crate::disk::copy;
use crate::fault;
use crate::run_folder::{RolloutName, RunFolder};
use std::io::{Error, ErrorKind, Result};
use std::path::Path;

/// Keeps a checkpoint from being pruned: hard links, or copies where those cannot be. One that is pinned stays as it is.
pub fn pin(run: &RunFolder, rollout: u64) -> Result<()> {
    let place = run.validation(rollout);
    let [manifest, tensors] = [RolloutName::Manifest, RolloutName::Tensors].map(|kind| place.join(kind.of(rollout)));
    let id = run.id().unwrap_or_default();
    if tensors.is_file() && Manifest::read(&manifest).is_ok_and(|pinned| !pinned.is_of_another(&id)) {
        return Ok(());
    }
    std::fs::create_dir_all(&place).map_err(|cause| at(&place, &cause))?;
    // The manifest last, as always: a checkpoint without one does not exist.
    remove(&manifest)?;
    for (from, to) in [(run.checkpoint_tensors(rollout), tensors), (run.checkpoint_manifest(rollout), manifest)] {
        fault::reach("validation.before_link");
        remove(&to)?;
        std::fs::hard_link(&from, &to).or_else(|_| copy(&from, &to)).map_err(|cause| at(&from, &cause))?;
    }
    Ok(())
}

/// Lets go of a checkpoint; its result stays.
pub fn unpin(run: &RunFolder, rollout: u64) -> Result<()> {
    // The manifest first: without it the rest does not count.
    [RolloutName::Manifest, RolloutName::Tensors]
        .iter()
        .try_for_each(|kind| remove(&run.validation(rollout).join(kind.of(rollout))))
}

fn remove(path: &Path) -> Result<()> {
    match std::fs::remove_file(path) {
        Err(cause) if cause.kind() != ErrorKind::NotFound => Err(at(path, &cause)),
        _ => Ok(()),
    }
}

fn at(path: &Path, cause: &Error) -> Error {
    Error::new(cause.kind(), format!("{}: {cause}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pinned_checkpoint_survives_its_pruning_and_what_was_torn_is_pinned_anew() {
        let temporary = tempfile::tempdir().unwrap();
        let run = RunFolder::new(temporary.path());
        std::fs::create_dir_all(run.checkpoints()).unwrap();
        std::fs::write(run.checkpoint_tensors(7), "tensors").unwrap();
        std::fs::write(run.checkpoint_manifest(7), "manifest").unwrap();
        // Left by a kill in the middle of a copy.
        std::fs::create_dir_all(run.validation(7)).unwrap();
        std::fs::write(run.validation(7).join(RolloutName::Manifest.of(7)), "mani").unwrap();
        pin(&run, 7).unwrap();
        std::fs::remove_file(run.checkpoint_tensors(7)).unwrap();
        let read = |kind: RolloutName| std::fs::read_to_string(run.validation(7).join(kind.of(7)));
        assert_eq!(read(RolloutName::Tensors).unwrap(), "tensors");
        assert_eq!(read(RolloutName::Manifest).unwrap(), "manifest");
        let error = pin(&run, 8).unwrap_err().to_string();
        assert!(error.contains("rollout-00000008.safetensors: "), "{error}");
        unpin(&run, 7).unwrap();
        assert!(read(RolloutName::Tensors).is_err() && run.validation(7).is_dir());
        unpin(&run, 7).unwrap();
    }
}
