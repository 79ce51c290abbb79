//! The figures of an update: sums over chunks and learners, then means over the steps of the optimiser.
//!
//! What a step gives stays on its device until the update is through. Whoever read it sooner would have the GPU wait for
//! the CPU, and the CPU for the GPU, at every step. (Several learners on CPUs wait at each, for the sum of their
//! gradients.)

use crate::auxiliary::{Auxiliary, Tally};
use crate::peers::{PeerError, Peers};
use crate::shards::Shards;
use proto::metric;
use std::collections::BTreeMap;
use tch::{Device, Kind, Tensor};

/// Names of the scalars of a pass, in the order in which they are kept.
pub const SCALARS: [&str; 6] = [
    metric::POLICY_LOSS,
    metric::VALUE_LOSS,
    metric::ENTROPY,
    metric::AUXILIARY_LOSS,
    metric::CLIP_FRACTION,
    metric::APPROXIMATE_KL,
];

/// This learner's part of one step of the optimiser.
#[derive(Debug)]
pub(crate) struct StepSums {
    /// Of each shard [`SCALARS`], then the auxiliary task's sums; doubles on the device, \[shards, K\].
    numbers: Tensor,
}

impl StepSums {
    pub(crate) fn new(auxiliary: &Auxiliary, shards: &Shards, device: Device) -> Self {
        let size = [shards.columns().len(), SCALARS.len() + auxiliary.sums().len()];
        Self { numbers: Tensor::zeros(size.map(|count| count as i64), (Kind::Double, device)) }
    }

    /// Adds the scalars of a shard's pass, in the order of [`SCALARS`], and what the auxiliary task counted, if it was
    /// asked.
    pub(crate) fn add_pass(&mut self, shard: usize, scalars: &[Tensor; SCALARS.len()], counted: &[Tensor]) {
        let of_shard = self.numbers.select(0, shard as i64);
        let add = |first: usize, numbers: &[Tensor]| {
            if !numbers.is_empty() {
                let numbers = Tensor::stack(numbers, 0).detach().to_kind(Kind::Double);
                let _ = of_shard.narrow(0, first as i64, numbers.size()[0]).g_add_(&numbers);
            }
        };
        add(0, scalars);
        add(SCALARS.len(), counted);
    }

    /// With the norm of the step's gradient before clipping, as [`UpdateSums`] keeps it.
    pub(crate) fn with_norm(&self, gradient_norm: &Tensor) -> Tensor {
        Tensor::cat(&[self.numbers.flatten(0, -1), gradient_norm.reshape([1])], 0)
    }

    /// Sums over all learners, with the norm of the step's gradient and the number of its queries.
    pub(crate) fn read(
        &self,
        gradient_norm: &Tensor,
        queries: u64,
        auxiliary: &Auxiliary,
        (shards, peers): (&Shards, &Peers),
    ) -> Result<StepMetrics, PeerError> {
        let mut steps = UpdateSums::default();
        steps.add(self.with_norm(gradient_norm), queries);
        Ok(steps.read(auxiliary, (shards, peers))?.remove(0))
    }
}

/// This learner's parts of the steps of an update.
#[derive(Debug, Default)]
pub(crate) struct UpdateSums {
    /// Of each step its sums and the norm of its gradient, \[shards · K + 1\].
    numbers: Vec<Tensor>,
    queries: Vec<u64>,
}

impl UpdateSums {
    /// Adds a step, as [`StepSums::with_norm`] has it, with the number of its queries.
    pub(crate) fn add(&mut self, step: Tensor, queries: u64) {
        self.numbers.push(step);
        self.queries.push(queries);
    }

    /// The last step alone.
    pub(crate) fn last(&self) -> Self {
        let numbers = self.numbers.last().map(Tensor::shallow_clone);
        Self { numbers: numbers.into_iter().collect(), queries: self.queries.last().copied().into_iter().collect() }
    }

    /// Waits for the device, and adds up over all learners.
    pub(crate) fn read(
        &self,
        auxiliary: &Auxiliary,
        (shards, peers): (&Shards, &Peers),
    ) -> Result<Vec<StepMetrics>, PeerError> {
        if self.numbers.is_empty() {
            return Ok(Vec::new());
        }
        let names = auxiliary.sums();
        let all = Tensor::stack(&self.numbers, 0).to_device(Device::Cpu);
        let (steps, width) = (self.numbers.len(), SCALARS.len() + names.len());
        let doubles = |tensor: &Tensor| {
            let mut numbers = vec![0.0; tensor.numel()];
            tensor.contiguous().copy_data(&mut numbers, tensor.numel());
            numbers
        };
        let count = shards.columns().len();
        let of_shard = |shard: usize| doubles(&all.narrow(1, (shard * width) as i64, width as i64));
        let numbers = shards.sum(&(0..count).map(of_shard).collect::<Vec<_>>(), peers)?;
        let norms = doubles(&all.select(1, (count * width) as i64));
        assert_eq!((numbers.len(), norms.len()), (steps * width, steps), "all numbers of all steps");
        let step = |((numbers, &gradient_norm), &queries): ((&[f64], &f64), &u64)| {
            let (scalars, sums) = numbers.split_at(SCALARS.len());
            let scalars = scalars.try_into().expect("it was split there");
            StepMetrics { scalars, tally: Tally::of(names, sums), queries, gradient_norm }
        };
        Ok(numbers.chunks_exact(width).zip(&norms).zip(&self.queries).map(step).collect())
    }
}

#[derive(Debug, Default)]
pub(crate) struct StepMetrics {
    /// Means over the minibatch, named by [`SCALARS`].
    pub scalars: [f64; SCALARS.len()],
    /// Sums that the auxiliary task's figures are made of.
    pub tally: Tally,
    /// Queries to the auxiliary task, of all learners.
    pub queries: u64,
    /// Norm of the gradient before clipping: not finite if one of its numbers is not.
    pub gradient_norm: f64,
}

impl StepMetrics {
    /// An estimate of the KL divergence of the policy from the one that acted.
    pub(crate) fn approximate_kl(&self) -> f64 {
        let [.., approximate_kl] = self.scalars;
        approximate_kl
    }

    pub(crate) fn first_non_finite(&self) -> Option<&'static str> {
        let scalars = self.scalars.iter().zip(SCALARS);
        let mut all = scalars.chain([(&self.gradient_norm, metric::GRADIENT_NORM)]);
        all.find(|(scalar, _)| !scalar.is_finite()).map(|(_, name)| name)
    }
}

/// Means over an update's steps, by name; the auxiliary task's figures are over all queries of all steps.
pub(crate) fn means(steps: &[StepMetrics], auxiliary: &Auxiliary) -> BTreeMap<String, f64> {
    let mut tally = Tally::default();
    for step in steps {
        tally.merge(&step.tally);
    }
    let sum = |of: &dyn Fn(&StepMetrics) -> f64| steps.iter().map(of).sum::<f64>();
    let count = steps.len() as f64;
    // Only steps with queries have an auxiliary loss.
    let asked = steps.iter().filter(|step| step.queries > 0).count().max(1) as f64;
    let mut metrics = auxiliary.figures(&tally);
    for (index, name) in SCALARS.into_iter().enumerate() {
        let of = if name == metric::AUXILIARY_LOSS { asked } else { count };
        metrics.insert(name.to_owned(), sum(&|step| step.scalars[index]) / of);
    }
    if auxiliary.is_none() {
        metrics.remove(metric::AUXILIARY_LOSS);
    }
    metrics.insert(metric::GRADIENT_NORM.to_owned(), sum(&|step| step.gradient_norm) / count);
    metrics
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::auxiliary::Sizes;
    use crate::network::Layout;
    use proto::config::{AuxiliaryConfig, AuxiliaryTask, Config};

    fn task() -> Auxiliary {
        let config = AuxiliaryConfig { task: AuxiliaryTask::InverseDynamics, ..Config::default().auxiliary };
        Auxiliary::new(&config, &mut Layout::default(), Sizes { hidden: 4, actions: 3 })
    }

    #[test]
    fn a_minibatch_without_queries_has_no_part_in_the_auxiliary_loss() {
        let steps = [(1.0, 0.0, 0), (2.0, 5.0, 3), (3.0, 7.0, 1), (6.0, 0.0, 0)].map(|(policy, auxiliary, queries)| {
            let scalars = [policy, 0.0, 0.0, auxiliary, 0.0, 0.0];
            StepMetrics { scalars, queries, ..StepMetrics::default() }
        });
        let figures = means(&steps, &task());
        assert_eq!((figures[metric::POLICY_LOSS], figures[metric::AUXILIARY_LOSS]), (3.0, 6.0));
        assert_eq!(means(&steps[..1], &task())[metric::AUXILIARY_LOSS], 0.0);
    }

    /// Passes of a shard first, then shards in their order, whatever the order of the passes.
    #[test]
    fn shards_are_added_in_their_order() {
        let mut config = Config::default();
        (config.actors.count, config.learner.shards) = (4, 4);
        let (task, shards) = (task(), Shards::of(&config, &(0..4)));
        let mut step = StepSums::new(&task, &shards, Device::Cpu);
        for (shard, number) in [(3, 0.5), (2, -1e30), (0, 1e30), (1, 1.0), (2, 0.0)] {
            step.add_pass(shard, &[0; 6].map(|_| Tensor::from(number)), &[]);
        }
        let read = step.read(&Tensor::from(1.0), 0, &task, (&shards, &Peers::Alone)).unwrap();
        assert_eq!(read.scalars, [0.5; 6], "the 1 vanishes beside 1e30, the half comes after");
    }

    #[test]
    fn passes_add_up_and_steps_stay_apart() {
        let single = |number: f32| Tensor::from(number);
        let pass = |first: f32| [0.0, 0.5, 1.0, 1.5, 2.0, 2.5].map(|more| single(first + more));
        let (task, norm) = (task(), |norm: f64| Tensor::from(norm));
        let mut sums = UpdateSums::default();
        let shards = Shards::one(1);
        let mut step = StepSums::new(&task, &shards, Device::Cpu);
        step.add_pass(0, &pass(1.0), &[Tensor::from(3_i64), Tensor::from(4.0_f64)]);
        step.add_pass(0, &pass(0.1), &[Tensor::from(1_i64), Tensor::from(2.0_f64)]);
        sums.add(step.with_norm(&norm(0.25)), 6);
        let mut step = StepSums::new(&task, &shards, Device::Cpu);
        step.add_pass(0, &pass(7.0), &[]);
        sums.add(step.with_norm(&norm(f64::NAN)), 0);

        let steps = sums.read(&task, (&shards, &Peers::Alone)).unwrap();
        let of_parts = [0.0_f32, 0.5, 1.0, 1.5, 2.0, 2.5].map(|more| f64::from(1.0 + more) + f64::from(0.1 + more));
        assert_eq!(steps[0].scalars, of_parts, "in double");
        assert_eq!((steps[0].tally.sum("right"), steps[0].tally.sum("asked")), (4.0, 6.0));
        assert_eq!((steps[0].gradient_norm, steps[0].queries, steps[0].first_non_finite()), (0.25, 6, None));
        assert_eq!((steps[1].scalars[0], steps[1].tally.sum("asked")), (7.0, 0.0));
        assert_eq!(steps[1].first_non_finite(), Some(metric::GRADIENT_NORM));
        assert!(UpdateSums::default().read(&task, (&shards, &Peers::Alone)).unwrap().is_empty());
    }
}
