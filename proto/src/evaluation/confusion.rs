//! How well disturbance was foretold.

use serde::{Deserialize, Serialize};

/// Predictions of disturbance against what came: counts of steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Confusion {
    /// Foretold, and it came.
    pub hits: u64,
    /// It came unforetold.
    pub misses: u64,
    /// Foretold, and it did not come.
    pub false_alarms: u64,
    /// Neither.
    pub quiet: u64,
}

impl Confusion {
    /// Counts one step.
    pub fn count(&mut self, foretold: bool, came: bool) {
        *match (foretold, came) {
            (true, true) => &mut self.hits,
            (false, true) => &mut self.misses,
            (true, false) => &mut self.false_alarms,
            (false, false) => &mut self.quiet,
        } += 1;
    }

    /// Adds another's counts.
    pub fn merge(&mut self, other: &Self) {
        self.hits += other.hits;
        self.misses += other.misses;
        self.false_alarms += other.false_alarms;
        self.quiet += other.quiet;
    }

    /// Share of the foretold that came; none when nothing was foretold.
    pub fn precision(&self) -> Option<f64> {
        share(self.hits, self.hits + self.false_alarms)
    }

    /// Share of what came that was foretold; none when nothing came.
    pub fn recall(&self) -> Option<f64> {
        share(self.hits, self.hits + self.misses)
    }

    /// Share of the quiet steps that were not foretold as disturbing; none when no step was quiet.
    pub fn recall_of_quiet(&self) -> Option<f64> {
        share(self.quiet, self.quiet + self.false_alarms)
    }
}

pub(super) fn share(part: u64, of: u64) -> Option<f64> {
    (of > 0).then(|| part as f64 / of as f64)
}
