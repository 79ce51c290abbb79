//! Auxiliary tasks: a loss on the belief besides those of policy and value (`docs/method.md`, Auxiliary tasks). A run
//! trains one of them or none.
//!
//! To add one: a file here with its [`Task`] and its `ENTRY`, a line in [`TASKS`], and its variant in
//! `proto::config::AuxiliaryTask`.
//!
//! A task's queries are chosen over the whole batch beforehand, and counted over each minibatch. So the losses of passes
//! over parts of the columns add up to the minibatch's mean.

mod cpca;
mod disturb;
mod inverse_dynamics;
mod query;
#[cfg(test)]
mod reward_prediction;
mod task;

pub use cpca::Cpca;
pub use disturb::Disturb;
pub use inverse_dynamics::InverseDynamics;
pub(crate) use query::count;
pub use query::{Epoch, Query};
pub(crate) use task::TaskEntry;
pub use task::{Pass, Sizes, Tally, Task, TaskLoss};

use crate::network::{Layout, Packing, Parameters};
use crate::peers::{PeerError, Peers};
use proto::config::{AuxiliaryConfig, AuxiliaryTask};
use std::collections::BTreeMap;
use tch::Tensor;

pub(crate) const TASKS: [TaskEntry; 3] = [disturb::ENTRY, inverse_dynamics::ENTRY, cpca::ENTRY];

#[derive(Debug)]
pub struct Auxiliary(Option<Box<dyn Task>>);

impl Auxiliary {
    /// Declares the parameters of the configured task. Panics if the task has no line in [`TASKS`].
    pub fn new(config: &AuxiliaryConfig, layout: &mut Layout, sizes: Sizes) -> Self {
        if config.task == AuxiliaryTask::None {
            return Self(None);
        }
        let entry = TASKS.into_iter().find(|entry| entry.task == config.task);
        let entry = entry.unwrap_or_else(|| panic!("{:?} has no line in TASKS", config.task));
        Self(Some((entry.declare)(layout, sizes, config)))
    }

    pub fn is_none(&self) -> bool {
        self.0.is_none()
    }

    /// What the task is asked in an epoch, one list for each of these passes: see [`Task::queries`].
    pub fn queries(&self, packings: &[&Packing], epoch: Epoch, peers: &Peers) -> Result<Vec<Vec<Query>>, PeerError> {
        match &self.0 {
            None => Ok(packings.iter().map(|_| Vec::new()).collect()),
            Some(task) => task.queries(packings, epoch, peers),
        }
    }

    /// Loss of one pass: see [`Task::loss`]. `None` without a task, or if it is asked nothing of this pass. Panics if
    /// the task does not give as many sums as it names.
    pub fn loss(&self, parameters: &Parameters, pass: &Pass, queries: &[Query], count: u64) -> Option<TaskLoss> {
        let task = self.0.as_ref().filter(|_| !queries.is_empty())?;
        let loss = task.loss(parameters, pass, queries, count);
        assert_eq!(loss.sums.len(), task.sums().len(), "a task gives each of its sums");
        Some(loss)
    }

    /// Names of the sums that the figures are made of, in a fixed order.
    pub fn sums(&self) -> &'static [&'static str] {
        self.0.as_ref().map_or(&[], |task| task.sums())
    }

    pub fn figures(&self, tally: &Tally) -> BTreeMap<String, f64> {
        self.0.as_ref().map(|task| task.figures(tally)).unwrap_or_default()
    }

    /// Logits of the task's label: see [`Task::label_logits`].
    pub(crate) fn label_logits(&self, parameters: &Parameters, beliefs: &Tensor) -> Option<Tensor> {
        self.0.as_ref()?.label_logits(parameters, beliefs)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tch::Device;

    #[test]
    fn every_task_of_the_configuration_has_a_line() {
        use AuxiliaryTask::{Cpca16, Disturb, InverseDynamics, None};
        for task in [None, Disturb, InverseDynamics, Cpca16] {
            // Without an arm for all others: a new variant compiles only when it is here and in the list above.
            let expected = match task {
                None => false,
                Disturb | InverseDynamics | Cpca16 => true,
            };
            assert_eq!(TASKS.iter().any(|entry| entry.task == task), expected, "{task:?}");
        }
    }

    #[test]
    fn a_task_has_its_configured_name_and_so_have_its_weights() {
        for entry in TASKS {
            assert_eq!(serde_json::to_value(entry.task).unwrap(), entry.name);
            let mut layout = Layout::default();
            (entry.declare)(&mut layout, Sizes { hidden: 4, actions: 3 }, &AuxiliaryConfig::default());
            let parameters = Parameters::new(layout, 1, Device::Cpu);
            let prefix = format!("auxiliary.{}.", entry.name);
            assert!(parameters.count() > 0 && parameters.named().all(|(name, _)| name.starts_with(&prefix)));
        }
    }
}
