//! A task as recordings need it: its messages, what of a step is compared, and what adds up over an episode.

use super::form::{Forms, Told};
use proto::config::Config;
use proto::replay::Compared;
use proto::task::{Spec, SpecError, Summing, Sums};
use std::collections::BTreeMap;
use std::error::Error;

pub struct Declared {
    pub spec: &'static Spec,
    pub forms: Forms,
    pub compared: Compared,
    summing: Summing,
}

impl Declared {
    pub fn of(config: &Config) -> Result<Self, String> {
        let wrong = |cause: &dyn Error| format!("its configuration: {cause}");
        let spec = config.find_spec().map_err(|cause| wrong(&cause))?;
        Self::task(spec, &config.reward.weights).map_err(|cause| wrong(&cause))
    }

    pub fn task(spec: &'static Spec, weights: &BTreeMap<String, f32>) -> Result<Self, SpecError> {
        let compared = Compared::of(spec, weights)?;
        Ok(Self { spec, forms: Forms::of(spec, &compared), compared, summing: Summing::of(spec) })
    }

    pub fn nothing(&self) -> Sums {
        self.summing.nothing(self.compared.rewards().len())
    }

    pub fn add(&self, sums: &mut Sums, step: &Told) {
        self.summing.add(sums, &step.record, &step.rewards);
    }

    /// Writes returns and metrics of an episode that ended with this step. Without `sums`, because steps are missing, only
    /// what the last one says is known.
    pub fn close(&self, sums: Option<&Sums>, last: &Told, end: &mut Told) {
        for (at, sum) in end.returns.iter_mut().enumerate() {
            *sum = sums.map(|sums| sums.returns[at]);
        }
        for (own, metric) in end.metrics.iter_mut().zip(self.summing.metrics(sums, &last.record)) {
            *own = metric;
        }
    }

    pub fn succeeded(&self, end: &Told) -> bool {
        self.spec.successes().any(|at| end.metrics[at] == Some(1.0))
    }
}
