//! What several learners of a run put together into one checkpoint, and take apart again.
//!
//! Weights, moments and counters are identical on all learners; each learner has its own beliefs and environments. A
//! checkpoint holds those of all in the order of the columns, as one learner would have written it: a run can go on
//! with another number of learners.

use super::Snapshot;
use super::tensors::{self, TensorsError};
use crate::agent::BELIEFS;
use crate::collector::Boundary;
use crate::network::Unfit;
use std::collections::BTreeMap;
use std::ops::Range;
use tch::Tensor;

/// Bytes before the tensors: the exchange.
const HEAD: usize = 8;

/// The state that only one learner has.
#[derive(Debug)]
pub struct Part {
    /// Beliefs \[columns, hidden\], on the CPU.
    pub beliefs: Tensor,
    /// Its environments.
    pub boundary: Boundary,
}

impl Part {
    /// As bytes.
    pub fn encode(&self) -> Result<Vec<u8>, TensorsError> {
        let tensors = BTreeMap::from([(BELIEFS.to_owned(), self.beliefs.shallow_clone())]);
        let mut bytes = self.boundary.exchange.to_le_bytes().to_vec();
        bytes.extend(tensors::encode(&tensors, &self.boundary)?);
        Ok(bytes)
    }

    /// What [`Part::encode`] wrote.
    pub fn decode(bytes: &[u8]) -> Result<Self, TensorsError> {
        let (head, rest) = bytes.split_first_chunk::<HEAD>().ok_or_else(|| Unfit::missing("exchange"))?;
        let (mut tensors, boundary) = tensors::decode(rest, u64::from_le_bytes(*head))?;
        let beliefs = tensors.remove(BELIEFS).ok_or_else(|| Unfit::missing(BELIEFS))?;
        Ok(Self { beliefs, boundary })
    }
}

impl Snapshot {
    /// Appends the next learner's part. If rollouts were cut short, learners are at different exchanges; all continue
    /// from the latest one.
    pub fn append(&mut self, part: Part) {
        let Part { beliefs, boundary: Boundary { exchange, environments, running } } = part;
        if let Some(own) = self.agent.tensors.get_mut(BELIEFS) {
            *own = Tensor::cat(&[own.shallow_clone(), beliefs], 0);
        }
        self.boundary.exchange = self.boundary.exchange.max(exchange);
        self.boundary.environments.extend(environments);
        self.boundary.running.extend(running);
    }

    /// Leaves only these columns: those of one learner.
    ///
    /// # Panics
    /// If it has not so many.
    pub fn keep(&mut self, columns: Range<usize>) {
        let all = self.boundary.environments.len();
        // The agent refuses beliefs of another number of environments.
        if let Some(own) = self.agent.tensors.get_mut(BELIEFS).filter(|own| own.size().first() == Some(&(all as i64))) {
            *own = own.narrow(0, columns.start as i64, columns.len() as i64).copy();
        }
        self.boundary.environments = self.boundary.environments[columns.clone()].to_vec();
        self.boundary.running = self.boundary.running[columns].to_vec();
    }
}
