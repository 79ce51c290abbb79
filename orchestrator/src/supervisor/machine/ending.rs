//! How a session ends: by a stop, a failure, at the budget, or because the run goes on with another number of actors.

use super::{Phase, Supervisor};
use crate::supervisor::event::{Action, Level, Outcome, Process, Saved, SessionEnd};
use crate::supervisor::messages::stopping;
use std::time::Duration;

impl Supervisor {
    pub(super) fn stop_before(&mut self, before: Option<u64>) {
        if self.phase == Phase::Running {
            let next = self.stages.next_rollout();
            self.stops_before = Some(before.map_or(next, |before| before.max(next)));
        }
    }

    pub(super) fn ends_before(&self, rollout: u64) -> bool {
        self.phase == Phase::Running && self.stops_before.is_some_and(|before| rollout >= before)
    }

    pub(super) fn begin(&mut self, now: Duration, rollout: u64, frames: u64) {
        if self.ends_before(rollout) {
            self.end_shape(now);
        } else {
            self.allow(rollout, frames);
        }
    }

    /// Has the learners save, because the next rollout has another number of actors. Where one has died, all are started
    /// again first, and get here once more.
    pub(super) fn end_shape(&mut self, now: Duration) {
        if self.learners_are_whole() {
            self.stop(now);
            if let Phase::Saving { goes_on, .. } = &mut self.phase {
                *goes_on = true;
            }
        }
    }

    pub(super) fn is_to_go_on(&self) -> bool {
        matches!(self.phase, Phase::Saving { goes_on: true, .. })
    }

    /// They could not save for that: they are started again, and get there once more. So are actors that died meanwhile.
    pub(super) fn run_on(&mut self, now: Duration) {
        self.phase = Phase::Running;
        // A new learner hears the last announcement first. If that is the stop, it leaves where it stands: too early.
        let announcement = self.stages.go_on();
        self.actions.push(Action::Announce(announcement));
        for actor in (0..self.deadlines.actors).map(Process::Actor) {
            if self.children.is_down(actor) {
                self.children.restart(actor, now);
            }
        }
    }

    pub(super) fn stop(&mut self, now: Duration) {
        if self.phase == Phase::Running {
            self.save(now, None);
            if matches!(self.phase, Phase::Saving { .. }) {
                self.report(Level::Info, stopping(self.learner_group.size(), self.evaluates()));
            }
        } else if let Phase::Saving { goes_on, .. } = &mut self.phase {
            // From now on it is a stop like any other.
            *goes_on = false;
        }
    }

    pub(super) fn interrupt(&mut self, now: Duration) {
        match &mut self.phase {
            Phase::Running => {
                self.save(now, None);
                self.report_interrupt();
            }
            // The user did not ask for this one.
            Phase::Saving { goes_on: goes_on @ true, .. } => {
                *goes_on = false;
                self.report_interrupt();
            }
            Phase::Over => {}
            // Also after an orderly stop from elsewhere: Ctrl-C then means to end at once.
            Phase::Saving { .. } | Phase::Leaving { .. } => {
                if let Phase::Saving { failure, .. } = &self.phase {
                    let end = failure.clone().map_or(SessionEnd::Interrupted, SessionEnd::Failed);
                    self.outcome = Some(Outcome { end, saved: None });
                    self.phase = Phase::Leaving { since: now };
                }
                for (process, _) in self.children.up() {
                    self.kill(now, process);
                }
                self.finish_if_alone();
            }
        }
    }

    fn report_interrupt(&mut self) {
        if matches!(self.phase, Phase::Saving { .. }) {
            let text = stopping(self.learner_group.size(), self.evaluates());
            self.report(Level::Info, format!("{text}; Ctrl-C again ends everything at once"));
        }
    }

    pub(super) fn fail(&mut self, now: Duration, reason: String) {
        self.report(Level::Error, reason.clone());
        self.save(now, Some(reason));
    }

    /// Has the learners save, if they can: they agree on where, so it takes all of them.
    fn save(&mut self, now: Duration, failure: Option<String>) {
        if self.learners_are_whole() && (self.learner_group.all_ready_since().is_some() || failure.is_none()) {
            let (work, first) = self.learner_group.work();
            let patience = match self.learner_group.starting_for(now) {
                Some(starting) => self.deadlines.learner_ready.saturating_sub(starting) + self.deadlines.first_save,
                None => self.deadlines.stop(work, &self.learner_group.pace, first),
            };
            self.phase = Phase::Saving { failure, since: now, patience, goes_on: false };
            self.learner_group.waits(now);
            self.announce_stop();
        } else {
            self.leave(now, failure.map_or(SessionEnd::Stopped, SessionEnd::Failed), None);
        }
    }

    /// The checkpoint of a stop has begun: from now on the stop waits for a disk.
    pub(super) fn save_begins(&mut self, now: Duration) {
        let (work, first) = self.learner_group.work();
        let left = self.deadlines.stop(work, &self.learner_group.pace, first);
        if let Phase::Saving { since, patience, .. } = &mut self.phase {
            (*since, *patience) = (now, left);
        }
    }

    /// A lost host ends the run with what is on the disk: learners can neither save nor go on without the others, and
    /// nobody else can start processes there.
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

    pub(super) fn leave(&mut self, now: Duration, end: SessionEnd, saved: Option<Saved>) {
        self.phase = Phase::Leaving { since: now };
        self.outcome = Some(Outcome { end, saved });
        self.children.stay_down();
        self.actions.extend(self.children.up().into_iter().map(|(process, _)| Action::CloseLifeline(process)));
        self.kill_broken(now);
        self.finish_if_alone();
    }

    pub(super) fn finish_if_alone(&mut self) {
        if self.children.up().is_empty() {
            self.finish();
        }
    }

    pub(super) fn finish(&mut self) {
        self.phase = Phase::Over;
        let outcome = self.outcome.take().expect("leaving begins with an outcome");
        self.actions.push(Action::Finish(outcome));
    }
}
