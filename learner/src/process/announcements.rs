//! What the orchestrator allows: the newest stage announcement.

use proto::config::StageConfig;
use proto::stage::position_at;
use wire::message::{StageAnnouncement, directive};

#[derive(Debug, Clone, Copy, Default)]
pub struct Announcements {
    newest: Option<StageAnnouncement>,
}

/// What the newest announcement means for a rollout.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Permission {
    Wait,
    Begin {
        /// Version to echo.
        version: u64,
    },
    Stop,
}

#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "rollout {rollout} was announced in stage {announced}, but {frames} frames belong to stage {expected}: \
     orchestrator and learner do not have the same run or configuration"
)]
pub struct WrongStage {
    rollout: u64,
    announced: u32,
    frames: u64,
    expected: usize,
}

impl Announcements {
    /// Takes one in. Versions only grow; an older one changes nothing.
    pub fn hear(&mut self, announcement: StageAnnouncement) {
        if self.newest.is_none_or(|newest| newest.version < announcement.version) {
            self.newest = Some(announcement);
        }
    }

    pub fn stop(&self) -> bool {
        self.newest.is_some_and(|newest| newest.directive == directive::STOP)
    }

    /// What is in force for `rollout`, which begins at `frames`. An announcement of a later rollout was made to a
    /// predecessor that got further; one of this rollout follows.
    pub fn permission(&self, stages: &[StageConfig], rollout: u64, frames: u64) -> Result<Permission, WrongStage> {
        match self.newest {
            Some(newest) if newest.directive == directive::STOP => Ok(Permission::Stop),
            Some(newest) if newest.directive == directive::TRAIN && newest.rollout == rollout => {
                let expected = position_at(stages, frames).map_or(stages.len(), |position| position.stage);
                if newest.stage as usize == expected {
                    Ok(Permission::Begin { version: newest.version })
                } else {
                    Err(WrongStage { rollout, announced: newest.stage, frames, expected })
                }
            }
            _ => Ok(Permission::Wait),
        }
    }
}
