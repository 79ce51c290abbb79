use serde::{Deserialize, Serialize};

/// Confusion matrix of the prediction of the label, in steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Confusion {
    /// True positives: predicted, and it happened.
    pub hits: u64,
    /// False negatives: it happened without prediction.
    pub misses: u64,
    /// False positives: predicted, and it did not happen.
    pub false_alarms: u64,
    /// True negatives.
    pub quiet: u64,
}

impl Confusion {
    pub fn count(&mut self, foretold: bool, came: bool) {
        *match (foretold, came) {
            (true, true) => &mut self.hits,
            (false, true) => &mut self.misses,
            (true, false) => &mut self.false_alarms,
            (false, false) => &mut self.quiet,
        } += 1;
    }

    pub(super) fn merged(self, other: Self) -> Self {
        Self {
            hits: self.hits + other.hits,
            misses: self.misses + other.misses,
            false_alarms: self.false_alarms + other.false_alarms,
            quiet: self.quiet + other.quiet,
        }
    }

    /// Precision: share of the predictions that came true; none without predictions.
    pub fn precision(&self) -> Option<f64> {
        share(self.hits, self.hits + self.false_alarms)
    }

    /// Recall: share of steps with the label that were predicted; none without such steps.
    pub fn recall(&self) -> Option<f64> {
        share(self.hits, self.hits + self.misses)
    }

    /// Recall of quiet steps: share of steps without the label that were predicted as such; none without such steps.
    pub(crate) fn recall_of_quiet(&self) -> Option<f64> {
        share(self.quiet, self.quiet + self.false_alarms)
    }
}

pub(super) fn share(part: u64, of: u64) -> Option<f64> {
    (of > 0).then(|| part as f64 / of as f64)
}
