//! Running statistics of observations and of discounted returns (`[normalize]`). They hold for a whole rollout: those of
//! observations take it in after the update with it, those of returns before it, so that the first targets are scaled,
//! too. Columns are merged in the order of the run's, so no bit depends on
//! how they are divided among learners or shards.

use super::moments::{Moments, RewardScale};
use crate::network::{Network, Unfit};
use crate::peers::{PeerError, Peers};
use crate::rollout::{Rollout, Step};
use proto::config::Config;
use std::collections::BTreeMap;
use tch::{Kind, Tensor};

/// What their names begin with in a checkpoint.
pub(crate) const STATISTICS: &str = "statistics.";
const OBSERVATIONS: &str = "statistics.observations";
const RETURNS: &str = "statistics.returns";

/// What was met so far, as far as the configuration asks for it.
#[derive(Debug, Clone)]
pub struct Running {
    observations: Option<Moments>,
    /// Of each number of an observation, whether it is normalised.
    normalized: Vec<bool>,
    returns: Option<Moments>,
    reward_clip: f64,
    /// Columns of the run.
    columns: usize,
}

impl Running {
    pub fn before(config: &Config) -> Self {
        let inputs = config.spec().inputs().expect("a validated configuration's task has what networks take");
        let normalize = config.normalize;
        Self {
            observations: (normalize.observations && inputs.width() > 0).then(|| Moments::before(inputs.width())),
            normalized: inputs.are_plain().collect(),
            returns: normalize.rewards.then(|| Moments::before(1)),
            reward_clip: normalize.reward_clip,
            columns: config.environments(),
        }
    }

    pub(crate) fn reward_scale(&self) -> RewardScale {
        self.returns.as_ref().map_or(RewardScale::NONE, |returns| RewardScale::of(returns, self.reward_clip))
    }

    /// Takes in the returns of a rollout, whose first column is this one of the run's.
    pub(crate) fn take_in_returns(
        &mut self,
        rollout: &Rollout,
        first_column: usize,
        peers: &Peers,
    ) -> Result<(), PeerError> {
        let Some(returns) = &mut self.returns else { return Ok(()) };
        merge(returns, rollout, [first_column, self.columns], peers, |step, _| step.discounted_return)
    }

    /// Takes in what a rollout has seen, and gives the network what is known now.
    pub(crate) fn take_in_observations(
        &mut self,
        rollout: &Rollout,
        first_column: usize,
        network: &Network,
        peers: &Peers,
    ) -> Result<(), PeerError> {
        if let Some(observations) = &mut self.observations {
            merge(observations, rollout, [first_column, self.columns], peers, |step, i| f64::from(step.numbers[i]))?;
            let of = |(i, &normalized): (usize, &bool)| {
                let [mean, variance] = if normalized { observations.of_number(i) } else { [0.0, 1.0] };
                // Finite in 32 bits, too.
                [mean as f32, variance.min(f64::from(f32::MAX)) as f32]
            };
            let known: Vec<[f32; 2]> = self.normalized.iter().enumerate().map(of).collect();
            network.normalize_by(&known);
        }
        Ok(())
    }

    /// For a checkpoint, by name.
    pub(crate) fn tensors(&self) -> impl Iterator<Item = (String, Tensor)> {
        let named = [(OBSERVATIONS, &self.observations), (RETURNS, &self.returns)];
        named
            .into_iter()
            .filter_map(|(name, moments)| Some((name.to_owned(), Tensor::from_slice(&moments.as_ref()?.to_numbers()))))
    }

    /// The same with what a checkpoint's tensors hold of it; of what they lack nothing was met.
    pub(crate) fn found_in(&self, tensors: &BTreeMap<String, Tensor>) -> Result<Self, Unfit> {
        let mut found = self.clone();
        for (name, moments) in [(OBSERVATIONS, &mut found.observations), (RETURNS, &mut found.returns)] {
            let Some(moments) = moments else { continue };
            *moments = match tensors.get(name) {
                Some(saved) => read(name, saved, moments.width())?,
                None => Moments::before(moments.width()),
            };
        }
        Ok(found)
    }

    /// What a checkpoint of such a run has and these tensors lack, or the other way round.
    pub(crate) fn differing(&self, tensors: &BTreeMap<String, Tensor>) -> Option<Unfit> {
        [(OBSERVATIONS, &self.observations), (RETURNS, &self.returns)].into_iter().find_map(|(name, moments)| {
            match (moments.is_some(), tensors.contains_key(name)) {
                (true, false) => Some(Unfit::missing(name)),
                (false, true) => Some(Unfit::no_place(name)),
                _ => None,
            }
        })
    }
}

fn read(name: &str, saved: &Tensor, width: usize) -> Result<Moments, Unfit> {
    if saved.kind() != Kind::Double || saved.size() != [1 + 2 * width as i64] {
        let problem = format!("is {:?} {:?}, not Double [{}]", saved.kind(), saved.size(), 1 + 2 * width);
        return Err(Unfit { name: name.to_owned(), problem });
    }
    let mut numbers = vec![0.0f64; 1 + 2 * width];
    saved.contiguous().copy_data(&mut numbers, 1 + 2 * width);
    // A count, and squares of deviations.
    let sound = numbers.iter().all(|number| number.is_finite()) && numbers[0] > 0.0;
    if !sound || numbers[1 + width..].iter().any(|&square| square < 0.0) {
        return Err(Unfit::not_finite(name));
    }
    Ok(Moments::from_numbers(&numbers))
}

/// Merges a rollout's vectors, of which number `i` of a step is `number(step, i)`: those of each column, then the
/// columns of all learners in their order.
fn merge(
    moments: &mut Moments,
    rollout: &Rollout,
    [first_column, columns]: [usize; 2],
    peers: &Peers,
    number: impl Fn(&Step, usize) -> f64,
) -> Result<(), PeerError> {
    let width = moments.width();
    let each = 1 + 2 * width;
    // Each learner fills the places of its own: to add zeros changes nothing.
    let mut places = vec![0.0; columns * each];
    for (column, place) in places[first_column * each..].chunks_exact_mut(each).take(rollout.columns()).enumerate() {
        let of_column = Moments::of(rollout.steps_of(column), width, |t, i| number(rollout.step(t, column), i));
        place.copy_from_slice(&of_column.to_numbers());
    }
    peers.sum(&mut places)?;
    places.chunks_exact(each).for_each(|place| moments.merge(&Moments::from_numbers(place)));
    Ok(())
}
