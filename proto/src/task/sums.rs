//! What the steps of an episode add up to.

use super::layout::Layout;
use super::metric::{Measure, Over};
use super::spec::Spec;

#[derive(Debug, Clone, PartialEq, Default)]
pub struct Sums {
    pub returns: Vec<f64>,
    metrics: Vec<f64>,
}

#[derive(Debug, Clone)]
pub struct Summing {
    layout: Layout,
    measures: Vec<Measure>,
}

impl Summing {
    pub fn of(spec: &Spec) -> Self {
        Self { layout: spec.layout().clone(), measures: spec.measures() }
    }

    /// Before an episode's first step, with this many rewards.
    pub fn nothing(&self, rewards: usize) -> Sums {
        Sums { returns: vec![0.0; rewards], metrics: vec![0.0; self.measures.len()] }
    }

    /// Adds a step: the record of what its action did, and its rewards.
    pub fn add(&self, sums: &mut Sums, record: &[u8], rewards: &[f32]) {
        for (sum, &reward) in sums.returns.iter_mut().zip(rewards) {
            *sum += f64::from(reward);
        }
        // Those of the last step are made of its record alone, when it is known.
        let running = sums.metrics.iter_mut().zip(&self.measures).filter(|(_, measure)| measure.over != Over::Last);
        for (metric, measure) in running {
            *metric = measure.after(|index| self.layout.fields[index].number(record), *metric);
        }
    }

    /// The metrics of an episode that ended with this record. Without `sums`, because steps are missing, only those are
    /// known that are of its last step.
    pub fn metrics<'a>(
        &'a self,
        sums: Option<&'a Sums>,
        last: &'a [u8],
    ) -> impl ExactSizeIterator<Item = Option<f64>> + 'a {
        self.measures.iter().enumerate().map(move |(at, measure)| match measure.over {
            Over::Last => Some(measure.after(|index| self.layout.fields[index].number(last), 0.0)),
            _ => measure.of_episode(sums?.metrics[at]),
        })
    }
}
