//! What several learners of a run put together into one checkpoint, and take apart again; and what becomes of columns
//! when the number of actors changes.
//!
//! Weights, moments and counters are identical on all learners; each learner has its own beliefs and environments. A
//! checkpoint holds those of all in the order of the columns, as one learner would have written it: a run can go on
//! with another number of learners.
//!
//! It holds all columns that the run has ever had. With fewer actors the last ones rest: they stay as they are in every
//! later checkpoint, and go on from there when their actor comes back. A column that the run never had begins its first
//! episode. So each episode of an environment is played once, whatever the number of actors was meanwhile.

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
    pub boundary: Boundary,
}

impl Part {
    pub fn encode(&self) -> Result<Vec<u8>, TensorsError> {
        let tensors = BTreeMap::from([(BELIEFS.to_owned(), self.beliefs.shallow_clone())]);
        let mut bytes = self.boundary.exchange.to_le_bytes().to_vec();
        bytes.extend(tensors::encode(&tensors, &self.boundary)?);
        Ok(bytes)
    }

    pub fn decode(bytes: &[u8]) -> Result<Self, TensorsError> {
        let (head, rest) = bytes.split_first_chunk::<HEAD>().ok_or_else(|| Unfit::missing("exchange"))?;
        let (mut tensors, boundary) = tensors::decode(rest, u64::from_le_bytes(*head))?;
        let beliefs = tensors.remove(BELIEFS).ok_or_else(|| Unfit::missing(BELIEFS))?;
        Ok(Self { beliefs, boundary })
    }

    /// The same part, to be appended more than once.
    #[must_use]
    pub fn again(&self) -> Self {
        Self { beliefs: self.beliefs.shallow_clone(), boundary: self.boundary.clone() }
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

    /// Adds the columns that are missing of so many: each is about to begin its first episode.
    pub(crate) fn widen(&mut self, columns: usize) {
        let all = self.boundary.environments.len();
        let more = columns.saturating_sub(all);
        if let Some(own) = self.agent.tensors.get_mut(BELIEFS)
            && let [held, hidden] = own.size()[..]
            && held == all as i64
        {
            let new = Tensor::zeros([more as i64, hidden], (own.kind(), own.device()));
            *own = Tensor::cat(&[own.shallow_clone(), new], 0);
        }
        let Boundary { environments, running, .. } = Boundary::start(more);
        self.boundary.environments.extend(environments);
        self.boundary.running.extend(running);
    }

    /// The columns from this one on, which rest; none if there are not so many.
    pub(crate) fn resting(&self, from: usize) -> Option<Part> {
        let Boundary { exchange, environments, running } = &self.boundary;
        let count = environments.len().checked_sub(from).filter(|&count| count > 0)?;
        let beliefs = self.agent.tensors.get(BELIEFS)?.narrow(0, from as i64, count as i64).copy();
        let (environments, running) = (environments[from..].to_vec(), running[from..].to_vec());
        Some(Part { beliefs, boundary: Boundary { exchange: *exchange, environments, running } })
    }

    /// Leaves only these columns: those of one learner. Panics if it has not so many.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::agent::AgentState;
    use proto::config::CarriedGoal;
    use tch::{Device, Kind};
    use wire::message::EnvironmentState;

    /// Columns in the episodes 5, 6, ..., with beliefs that show which is which.
    fn snapshot(columns: i64) -> Snapshot {
        let beliefs = Tensor::arange(2 * columns, (Kind::Float, Device::Cpu)).reshape([columns, 2]);
        let tensors = BTreeMap::from([(BELIEFS.to_owned(), beliefs)]);
        let agent = AgentState { tensors, adam_steps: 1, multiplier: 0.0, carried_goal: CarriedGoal::ObjectToGoal };
        let mut boundary = Boundary { exchange: 30, ..Boundary::start(columns as usize) };
        for (column, state) in boundary.environments.iter_mut().enumerate() {
            *state = EnvironmentState::start_of(5 + column as u32);
        }
        Snapshot { rollout: 3, frames: 9, agent, boundary, weights: "w".into() }
    }

    fn episodes(snapshot: &Snapshot) -> Vec<u32> {
        snapshot.boundary.environments.iter().map(|state| state.episode).collect()
    }

    fn beliefs(snapshot: &Snapshot) -> Vec<f32> {
        Vec::try_from(snapshot.agent.tensors[BELIEFS].flatten(0, -1)).unwrap()
    }

    #[test]
    fn columns_rest_come_back_as_they_were_and_new_ones_begin_their_first_episode() {
        let mut fewer = snapshot(3);
        assert!(fewer.resting(3).is_none(), "all are in use");
        let rest = fewer.resting(2).unwrap();
        fewer.keep(0..2);
        // Twice: every later checkpoint holds them.
        let mut later = snapshot(2);
        for saved in [&mut fewer, &mut later] {
            saved.append(rest.again());
            assert_eq!(episodes(saved), [5, 6, 7]);
            assert_eq!(beliefs(saved), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
        }
        later.widen(5);
        assert_eq!(episodes(&later), [5, 6, 7, 0, 0]);
        assert_eq!(beliefs(&later)[4..], [4.0, 5.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!((later.boundary.running.len(), later.boundary.exchange), (5, 30));
        later.widen(2);
        assert_eq!(episodes(&later).len(), 5, "nothing is lost");
    }
}
