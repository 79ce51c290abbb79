//! What the supervisor does when a host is lost: the run ends with what is on the disk. Learners can neither save nor go
//! on without the others, and nobody else can start processes there.

use super::{Phase, Supervisor};
use crate::supervisor::event::{Level, Process, SessionEnd};
use std::time::Duration;

impl Supervisor {
    pub(super) fn host_lost(&mut self, now: Duration, processes: &[Process], reason: String) {
        for &process in processes {
            self.children.lose(process);
        }
        match self.phase {
            Phase::Running | Phase::Saving { .. } => {
                self.report(Level::Error, reason.clone());
                self.leave(now, SessionEnd::HostLost(reason), None);
            }
            Phase::Leaving { .. } => {
                // It ends as it would have: all that matters was saved before.
                self.report(Level::Warning, reason);
                if !self.learner_group.has_finished(0) {
                    self.kill_broken(now);
                }
                self.finish_if_alone();
            }
            Phase::Over => {}
        }
    }
}
