//! The belief: a one-layer GRU or LSTM that is zeroed at episode starts, one step at a time when acting and over whole
//! rollouts when training. Its state is carried from step to step; the belief is its output: all of a GRU's state, and
//! what stands before the cell in an LSTM's. Without memory it is what is seen now, and there is nothing to carry.
//!
//! A rollout of T steps × N columns, cut at its episode starts, is a set of segments. Sorted by length they form
//! PyTorch's packed sequence: first the first row of every segment, then the second row of those that have one, and so
//! on. That takes as many steps as the longest segment has, with no masks, and frameworks have a fast path for it
//! (a masked loop over T took ten times as long on a GPU).
//!
//! Rows of a training batch have no other order than this one: [`Packing`] says which (step, column) each row is, the
//! encoder and the losses run over rows, and nothing differentiable is ever permuted.

use super::initialize::Initial;
use super::layers::{Recurrent, Unit};
use super::parameters::{Layout, Parameters};
use crate::device::upload;
use proto::config::Memory;
use std::ops::Range;
use tch::{Device, Kind, Tensor};

/// The belief's unit, if there is one.
#[derive(Debug)]
pub struct Belief {
    recurrent: Option<Recurrent>,
}

impl Belief {
    /// Declares the unit, if there is to be one: orthogonal weights, zero biases.
    pub fn new(layout: &mut Layout, path: &str, memory: Memory, sizes: [i64; 2]) -> Self {
        let unit = match memory {
            Memory::Gru => Unit::Gru,
            Memory::Lstm => Unit::Lstm,
            Memory::None => return Self { recurrent: None },
        };
        let initial = [Initial::Orthogonal { gain: 1.0 }, Initial::Constant(0.0)];
        Self { recurrent: Some(Recurrent::new(layout, path, unit, sizes, initial)) }
    }

    /// Width of the state that is carried from step to step: 0 without memory.
    pub fn state(&self) -> i64 {
        self.recurrent.map_or(0, |recurrent| recurrent.state())
    }

    /// One step: observations \[rows, inputs\] and states before them \[rows, state\] → states after them.
    pub fn step(&self, parameters: &Parameters, x: &Tensor, before: &Tensor) -> Tensor {
        self.recurrent.map_or_else(|| x.shallow_clone(), |recurrent| recurrent.step(parameters, x, before))
    }

    /// The beliefs \[rows, hidden\] in what [`Belief::step`] gives.
    pub fn of(&self, states: &Tensor) -> Tensor {
        self.recurrent.map_or_else(|| states.shallow_clone(), |recurrent| recurrent.output(states))
    }

    /// The unit, for whoever takes a step in parts.
    ///
    /// # Panics
    /// Without memory.
    pub(crate) fn recurrent(&self) -> &Recurrent {
        self.recurrent.as_ref().expect("a network with memory")
    }

    /// All steps: observations \[rows, inputs\] in the order of `packing`, states of all columns at the rollout's
    /// start \[columns, state\] → beliefs \[rows, hidden\] in the same order.
    pub fn unroll(&self, parameters: &Parameters, x: &Tensor, packing: &Packing, at_start: &Tensor) -> Tensor {
        let Some(recurrent) = self.recurrent else { return x.shallow_clone() };
        let device = x.device();
        let columns = upload(&packing.columns, device);
        let carried = upload(&packing.carried, device).unsqueeze(1);
        let before = at_start.index_select(0, &columns) * carried;
        recurrent.packed(parameters, x, &packing.batch_sizes, &before)
    }

    /// The state before anything was seen, \[columns, state\].
    pub(crate) fn blank(&self, columns: i64, device: Device) -> Tensor {
        Tensor::zeros([columns, self.state()], (Kind::Float, device))
    }
}

/// Which (step, column) each row of a training batch is, in the order of a packed sequence.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Packing {
    /// Row → (step, column).
    pub rows: Vec<(usize, usize)>,
    /// Segments that have a k-th row.
    batch_sizes: Vec<i64>,
    /// Segment → its column.
    columns: Vec<i64>,
    /// Segment → whether it goes on from the column's belief at the rollout's start (else from zero).
    carried: Vec<bool>,
}

impl Packing {
    /// Packs some columns of a rollout, of which column n has `steps(n)` rows and begins an episode at row t when
    /// `episode_start(t, n)`.
    pub fn new(
        columns: impl IntoIterator<Item = usize>,
        steps: impl Fn(usize) -> usize,
        episode_start: impl Fn(usize, usize) -> bool,
    ) -> Self {
        struct Segment {
            column: usize,
            rows: Range<usize>,
        }
        let mut segments: Vec<Segment> = vec![];
        for column in columns {
            let mut begin = 0;
            for t in 1..=steps(column) {
                if t == steps(column) || episode_start(t, column) {
                    segments.push(Segment { column, rows: begin..t });
                    begin = t;
                }
            }
        }
        // Stable: equal lengths stay in order of column and step.
        segments.sort_by_key(|segment| std::cmp::Reverse(segment.rows.len()));
        let longest = segments.first().map_or(0, |segment| segment.rows.len());
        let mut rows = vec![];
        let mut batch_sizes = vec![];
        for k in 0..longest {
            let alive = segments.partition_point(|segment| segment.rows.len() > k);
            rows.extend(segments[..alive].iter().map(|segment| (segment.rows.start + k, segment.column)));
            batch_sizes.push(alive as i64);
        }
        Self {
            rows,
            batch_sizes,
            columns: segments.iter().map(|segment| segment.column as i64).collect(),
            carried: segments.iter().map(|s| s.rows.start == 0 && !episode_start(0, s.column)).collect(),
        }
    }

    /// Packs frames in this order, for a network without memory: each is a segment of its own.
    pub(crate) fn of_rows(rows: Vec<(usize, usize)>) -> Self {
        let columns: Vec<i64> = rows.iter().map(|&(_, column)| column as i64).collect();
        Self { batch_sizes: vec![rows.len() as i64], carried: vec![false; rows.len()], columns, rows }
    }

    /// Of each row, the row that comes `offset` steps after it in its segment: in the rollout and in the same episode.
    pub fn later(&self, offset: usize) -> Vec<Option<i64>> {
        // Row k of segment s is the s-th of its block, because segments that end drop out from the back.
        let mut starts = Vec::with_capacity(self.batch_sizes.len());
        let mut start = 0;
        for &size in &self.batch_sizes {
            starts.push(start);
            start += size;
        }
        let mut later = Vec::with_capacity(self.rows.len());
        for (k, &size) in self.batch_sizes.iter().enumerate() {
            let (alive, start) = match self.batch_sizes.get(k + offset) {
                Some(&alive) => (alive, starts[k + offset]),
                None => (0, 0),
            };
            later.extend((0..size).map(|segment| (segment < alive).then_some(start + segment)));
        }
        later
    }

    /// Of each row, the last row of its segment.
    pub fn last(&self) -> Vec<i64> {
        let next = self.later(1);
        let mut last: Vec<i64> = (0..self.rows.len() as i64).collect();
        // A successor comes after its row.
        for row in (0..last.len()).rev() {
            if let Some(next) = next[row] {
                last[row] = last[next as usize];
            }
        }
        last
    }
}

#[cfg(test)]
mod tests {
    use super::super::parameters::to_vec;
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn packs_longest_segments_first() {
        // Column 0: one segment of 3, carried. Column 1: starts at 0 and at 1, one row held back.
        let start = |t: usize, n: usize| n == 1 && t <= 1;
        let packing = Packing::new(0..2, |n| 3 - n, start);
        assert_eq!(packing.rows, [(0, 0), (0, 1), (1, 1), (1, 0), (2, 0)]);
        assert_eq!(packing.batch_sizes, [3, 1, 1]);
        assert_eq!(packing.columns, [0, 1, 1]);
        assert_eq!(packing.carried, [true, false, false]);
        assert_eq!(packing.later(1), [Some(3), None, None, Some(4), None]);
        assert_eq!(packing.later(2), [Some(4), None, None, None, None]);
        assert_eq!(packing.last(), [4, 1, 2, 4, 4]);
    }

    proptest! {
        /// `later` is what the steps and episode starts say, one row at a time.
        #[test]
        fn later_rows_are_in_the_same_episode(
            steps in 1usize..12, columns in 1usize..6, offset in 0usize..14,
            starts in proptest::collection::vec(proptest::bool::weighted(0.2), 72),
        ) {
            let is_start = |t: usize, n: usize| starts[t * 6 + n];
            let packing = Packing::new(0..columns, |n| if n == 1 && steps > 1 { steps - 1 } else { steps }, is_start);
            let row_of = |wanted| packing.rows.iter().position(|&row| row == wanted).map(|row| row as i64);
            let later = packing.later(offset);
            for (row, &(t, n)) in packing.rows.iter().enumerate() {
                let same_episode = (t + 1..=t + offset).all(|t| t < steps && !is_start(t, n));
                let expected = if same_episode { row_of((t + offset, n)) } else { None };
                prop_assert_eq!(later[row], expected, "({}, {})", t, n);
            }
            for (row, last) in packing.last().into_iter().enumerate() {
                let (from, to) = (packing.rows[row], packing.rows[last as usize]);
                prop_assert!(to.1 == from.1 && packing.later(to.0 - from.0)[row] == Some(last));
                prop_assert_eq!(packing.later(to.0 - from.0 + 1)[row], None);
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        /// The packed unroll is the step-by-step belief of acting, for any pattern of episode starts and any cut.
        #[test]
        fn unroll_equals_stepping(
            steps in 1usize..12, columns in 1usize..6, first in 0usize..3, short in 0usize..6,
            starts in proptest::collection::vec(proptest::bool::weighted(0.2), 72),
            memory in proptest::sample::select(vec![Memory::Gru, Memory::Lstm]),
        ) {
            let first = first.min(columns - 1);
            let (inputs, hidden) = (7, 5);
            let mut layout = Layout::default();
            let belief = Belief::new(&mut layout, "belief", memory, [inputs, hidden]);
            let parameters = Parameters::new(layout, 3, Device::Cpu);
            tch::manual_seed(7);
            let x = Tensor::randn([steps as i64, columns as i64, inputs], (Kind::Float, Device::Cpu));
            let at_start = Tensor::randn([columns as i64, belief.state()], (Kind::Float, Device::Cpu));
            let is_start = |t: usize, n: usize| starts[t * 6 + n];
            // The last `short` columns have one row fewer.
            let length = |n: usize| if n + short >= columns && steps > 1 { steps - 1 } else { steps };

            let packing = Packing::new(first..columns, length, is_start);
            let picked: Vec<Tensor> =
                packing.rows.iter().map(|&(t, n)| x.get(t as i64).get(n as i64)).collect();
            let unrolled = belief.unroll(&parameters, &Tensor::stack(&picked, 0), &packing, &at_start);

            let mut seen = 0;
            for n in first..columns {
                let mut state = at_start.get(n as i64).unsqueeze(0);
                for t in 0..length(n) {
                    if is_start(t, n) {
                        state = belief.blank(1, Device::Cpu);
                    }
                    state = belief.step(&parameters, &x.get(t as i64).get(n as i64).unsqueeze(0), &state);
                    let row = packing.rows.iter().position(|&row| row == (t, n));
                    let row = row.expect("every valid row is packed") as i64;
                    let difference = (unrolled.get(row) - belief.of(&state).squeeze()).abs().max().double_value(&[]);
                    prop_assert!(difference < 1e-6, "({t}, {n}): {difference}");
                    seen += 1;
                }
            }
            prop_assert_eq!(seen, packing.rows.len());
            prop_assert_eq!(to_vec(&unrolled).len(), seen * hidden as usize);
        }
    }
}
