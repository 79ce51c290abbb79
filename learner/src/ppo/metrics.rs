//! The figures of an update: sums over chunks and learners, then means over the steps of the optimiser.

use crate::auxiliary::{Auxiliary, Tally};
use crate::network::to_vec;
use crate::peers::{PeerError, Peers};
use proto::metric;
use std::collections::BTreeMap;
use tch::Tensor;

/// Names of the scalars of a pass, in the order in which they are read back from the device.
pub const SCALARS: [&str; 6] = [
    metric::POLICY_LOSS,
    metric::VALUE_LOSS,
    metric::ENTROPY,
    metric::AUXILIARY_LOSS,
    metric::CLIP_FRACTION,
    metric::APPROXIMATE_KL,
];

/// Figures of one step of the optimiser.
#[derive(Debug, Default)]
pub(crate) struct StepMetrics {
    /// Means over the minibatch, named by [`SCALARS`]: each pass adds its part.
    pub scalars: [f64; SCALARS.len()],
    /// Sums that the auxiliary task's figures are made of.
    pub tally: Tally,
    /// Queries to the auxiliary task, of all learners.
    pub queries: u64,
}

impl StepMetrics {
    /// Adds a pass's scalars, in the order of [`SCALARS`].
    pub(crate) fn add_pass(&mut self, scalars: &[Tensor; SCALARS.len()]) {
        for (sum, scalar) in self.scalars.iter_mut().zip(to_vec(&Tensor::stack(scalars, 0))) {
            *sum += f64::from(scalar);
        }
    }

    /// Sums them over all learners.
    pub(crate) fn sum_over_learners(&mut self, auxiliary: &Auxiliary, peers: &Peers) -> Result<(), PeerError> {
        let names = auxiliary.sums();
        let mut numbers = self.scalars.to_vec();
        numbers.extend(names.iter().map(|name| self.tally.sum(name)));
        peers.sum(&mut numbers)?;
        let (scalars, sums) = numbers.split_at(SCALARS.len());
        self.scalars.copy_from_slice(scalars);
        self.tally = Tally::default();
        for (name, sum) in names.iter().zip(sums) {
            self.tally.add(name, *sum);
        }
        Ok(())
    }

    /// Name of the first scalar that is not finite.
    pub(crate) fn first_non_finite(&self) -> Option<&'static str> {
        self.scalars.iter().zip(SCALARS).find(|(scalar, _)| !scalar.is_finite()).map(|(_, name)| name)
    }
}

/// Figures of an update: sums over its steps.
#[derive(Debug, Default)]
pub(crate) struct UpdateMetrics {
    scalars: [f64; SCALARS.len()],
    tally: Tally,
    gradient_norms: f64,
    steps: u32,
    /// Steps with queries: only these have an auxiliary loss.
    asked: u32,
}

impl UpdateMetrics {
    /// Adds a step, with its gradient's norm before clipping.
    pub(crate) fn add_step(&mut self, step: &StepMetrics, gradient_norm: f64) {
        for (sum, scalar) in self.scalars.iter_mut().zip(step.scalars) {
            *sum += scalar;
        }
        self.tally.merge(&step.tally);
        self.gradient_norms += gradient_norm;
        self.steps += 1;
        self.asked += u32::from(step.queries > 0);
    }

    /// Means over the steps, by name; the auxiliary task's figures are over all queries of all steps.
    pub(crate) fn means(&self, auxiliary: &Auxiliary) -> BTreeMap<String, f64> {
        let steps = f64::from(self.steps);
        let of = |name| if name == metric::AUXILIARY_LOSS { f64::from(self.asked.max(1)) } else { steps };
        let mut metrics = auxiliary.figures(&self.tally);
        metrics.extend(SCALARS.iter().zip(self.scalars).map(|(name, sum)| ((*name).to_owned(), sum / of(*name))));
        if auxiliary.is_none() {
            metrics.remove(metric::AUXILIARY_LOSS);
        }
        metrics.insert(metric::GRADIENT_NORM.to_owned(), self.gradient_norms / steps);
        metrics
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::auxiliary::Sizes;
    use crate::network::Layout;
    use proto::config::{AuxiliaryConfig, AuxiliaryTask, Config};

    #[test]
    fn a_minibatch_without_queries_has_no_part_in_the_auxiliary_loss() {
        let mut metrics = UpdateMetrics::default();
        for (policy, auxiliary, queries) in [(1.0, 0.0, 0), (2.0, 5.0, 3), (3.0, 7.0, 1), (6.0, 0.0, 0)] {
            let scalars = [policy, 0.0, 0.0, auxiliary, 0.0, 0.0];
            metrics.add_step(&StepMetrics { scalars, queries, ..StepMetrics::default() }, 0.0);
        }
        let config = AuxiliaryConfig { task: AuxiliaryTask::InverseDynamics, ..Config::default().auxiliary };
        let task = Auxiliary::new(&config, &mut Layout::default(), Sizes { hidden: 4, actions: 3 });
        let means = metrics.means(&task);
        assert_eq!((means[metric::POLICY_LOSS], means[metric::AUXILIARY_LOSS]), (3.0, 6.0));
        assert_eq!(UpdateMetrics { steps: 1, ..UpdateMetrics::default() }.means(&task)[metric::AUXILIARY_LOSS], 0.0);
    }
}
