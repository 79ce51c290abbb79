//! An evaluation that was cut off: its orchestrator is dead, and there is no result. It is made anew, not gone on with.

use super::identity::Identity;
use super::remains;
use anyhow::{Context, Result};
use proto::run_folder::RunFolder;
use std::path::Path;
use std::time::Duration;

/// How long its processes are given to notice that their orchestrator is gone.
const PATIENCE: Duration = Duration::from_secs(2);

/// Removes an evaluation that was cut off, and what it left in shared memory.
pub fn remove_evaluation(result: &Path) -> Result<()> {
    if !result.exists() {
        return Ok(());
    }
    if let Ok(identity) = Identity::read(&RunFolder::new(result)) {
        for incarnation in identity.incarnations.iter().filter(|incarnation| incarnation.ended.is_none()) {
            remains::sweep(&identity.address(incarnation), PATIENCE)?;
        }
    }
    std::fs::remove_dir_all(result).with_context(|| format!("cannot remove {}", result.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_evaluation_that_was_cut_off_names_no_folder_that_is_deleted() {
        let temporary = tempfile::tempdir().unwrap();
        let (result, precious) = (temporary.path().join("result"), temporary.path().join("precious"));
        for folder in [&result, &precious] {
            std::fs::create_dir(folder).unwrap();
        }
        let mut identity = Identity::new().unwrap();
        identity.begin_incarnation();
        identity.incarnations[0].wire = format!("stillroom_@{}", precious.display());
        identity.write(&RunFolder::new(&result)).unwrap();
        remove_evaluation(&result).unwrap();
        assert!(precious.is_dir() && !result.exists());
    }
}
