//! Runs of units: how a length of wall is divided, and the counter top that lies over it.
//!
//! Units of fixed width (sink, stove, fridge) stand in the plan's order; cabinets share what is left evenly, so that
//! a run ends where it is meant to and no gap stays. A counter top goes from one tall unit or stove to the next; where
//! runs meet it turns the corner in one piece.

use super::draft::{Draft, Worktop, WorktopKind};
use super::frame::{Assembly, Frame, Span};
use crate::kitchen::room::Surface;
use proto::random::Random;

pub(super) const COUNTER_DEPTH_M: f32 = 0.62;
/// Length that a corner takes of either wall: the other run's depth and a filler, so that fronts can open, metres.
pub(super) const CORNER_M: f32 = 0.67;
const CABINET_WIDEST_M: f32 = 0.90;
/// What is narrower than this gets a blind panel, no cabinet, metres.
const FILLER_WIDEST_M: f32 = 0.18;
/// Room in which the sink's basin hangs, from the unit's sides and from the wall, metres.
pub(super) const BASIN_SIDE_M: f32 = 0.09;
pub(super) const BASIN_OUT_M: Span = [0.13, 0.54];

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Unit {
    /// Cabinets and drawers under the counter, as many as fill the length.
    Cabinets,
    /// Where another run's side stands before this one.
    Corner,
    /// A strip beside a corner, so that the first door can open.
    Filler,
    Fridge,
    Sink,
    Dishwasher,
    Stove,
}

#[derive(Debug, Clone, Copy)]
pub(super) struct Slot {
    pub unit: Unit,
    pub least_m: f32,
}

#[derive(Debug, Clone, Copy)]
pub(super) struct Placed {
    pub unit: Unit,
    pub along: Span,
}

#[derive(Debug, Clone)]
pub(super) struct Run {
    pub frame: Frame,
    pub units: Vec<Placed>,
    /// How far the top lies over the back: 0 at a wall.
    pub overhang_m: f32,
    /// Height of what hangs above, metres.
    pub headroom_m: f32,
    pub kind: WorktopKind,
}

impl Unit {
    /// Width of units that have one, metres.
    pub fn width_m(self) -> f32 {
        match self {
            Self::Cabinets => 0.0,
            Self::Corner => CORNER_M,
            Self::Filler => CORNER_M - COUNTER_DEPTH_M,
            Self::Fridge => 0.78,
            Self::Sink => 0.80,
            Self::Dishwasher => 0.60,
            Self::Stove => 0.64,
        }
    }

    fn bears_top(self) -> bool {
        !matches!(self, Self::Fridge | Self::Stove)
    }
}

/// Divides a length among the slots; none if it is too short even without a dishwasher.
pub(super) fn divide(slots: &[Slot], length_m: f32, random: &mut Random) -> Option<Vec<Placed>> {
    let need = |slots: &[Slot]| slots.iter().map(|slot| slot.least_m).sum::<f32>();
    let mut slots = slots.to_vec();
    if need(&slots) > length_m {
        slots.retain(|slot| slot.unit != Unit::Dishwasher);
    }
    let spare_m = length_m - need(&slots);
    if spare_m < 0.0 {
        return None;
    }
    let weights: Vec<f32> =
        slots.iter().map(|slot| if slot.unit == Unit::Cabinets { random.range(0.6, 1.4) } else { 0.0 }).collect();
    let total: f32 = weights.iter().sum();
    let mut at = 0.0;
    let placed = slots
        .iter()
        .zip(&weights)
        .map(|(slot, weight)| {
            let from = at;
            at += slot.least_m + spare_m * weight / total.max(f32::MIN_POSITIVE);
            Placed { unit: slot.unit, along: [from, at] }
        })
        .collect();
    Some(placed)
}

impl Run {
    pub fn along(&self) -> Span {
        [self.units.first().map_or(0.0, |unit| unit.along[0]), self.units.last().map_or(0.0, |unit| unit.along[1])]
    }

    pub fn of(&self, unit: Unit) -> impl Iterator<Item = Span> {
        self.units.iter().filter(move |placed| placed.unit == unit).map(|placed| placed.along)
    }
}

impl Draft<'_> {
    /// Builds everything of a run that stands on the floor, and its top. `joins` is the top of another run that goes
    /// on in this one's beginning. Returns the tops at the beginning and at the end.
    pub fn run(&mut self, run: &Run, joins: Option<usize>) -> [Option<usize>; 2] {
        for placed in &run.units {
            match placed.unit {
                Unit::Cabinets => self.cabinets_below(run.frame, placed.along),
                Unit::Corner => self.corner_below(run.frame, placed.along),
                Unit::Filler => self.filler(run.frame, placed.along),
                Unit::Fridge => self.fridge(run.frame, placed.along),
                Unit::Sink => self.sink(run.frame, placed.along),
                Unit::Dishwasher => self.dishwasher(run.frame, placed.along),
                Unit::Stove => self.stove(run.frame, placed.along),
            }
        }
        let mut ends = [joins, None];
        let mut joins = joins;
        for group in run.units.chunk_by(|a, b| a.unit.bears_top() && b.unit.bears_top()) {
            if !group[0].unit.bears_top() {
                joins = None;
                continue;
            }
            let top = self.counter_top(run, group);
            let index = if let Some(index) = joins.take() {
                let other = std::mem::replace(&mut self.tops[index], Assembly::new(run.frame));
                self.tops[index] = other.join(top);
                index
            } else {
                self.tops.push(top);
                self.tops.len() - 1
            };
            if group[0].along[0] == run.along()[0] {
                ends[0] = Some(index);
            }
            if group[group.len() - 1].along[1] == run.along()[1] {
                ends[1] = Some(index);
            }
        }
        ends
    }

    /// The top over neighbouring units, with a hole where a basin hangs, and the surfaces on it.
    fn counter_top(&mut self, run: &Run, units: &[Placed]) -> Assembly {
        let height = self.style.counter_height_m;
        let up = [height - self.style.slab_m, height];
        let whole_depth = [-run.overhang_m, COUNTER_DEPTH_M];
        let mut top = Assembly::new(run.frame);
        let mut from = units[0].along[0];
        let end = units[units.len() - 1].along[1];
        let sinks = units.iter().filter(|placed| placed.unit == Unit::Sink);
        for hole in sinks.map(|placed| [placed.along[0] + BASIN_SIDE_M, placed.along[1] - BASIN_SIDE_M]) {
            top = top.slab([from, hole[0]], up, whole_depth).slab(hole, up, [whole_depth[0], BASIN_OUT_M[0]]).slab(
                hole,
                up,
                [BASIN_OUT_M[1], whole_depth[1]],
            );
            self.worktop(run, [from, hole[0]]);
            from = hole[1];
        }
        self.worktop(run, [from, end]);
        top.slab([from, end], up, whole_depth)
    }

    fn worktop(&mut self, run: &Run, along: Span) {
        const LEAST_M: f32 = 0.1;
        if along[1] - along[0] < LEAST_M {
            return;
        }
        let height = self.style.counter_height_m;
        let (low, high) = run.frame.block(along, [height, run.headroom_m], [-run.overhang_m, COUNTER_DEPTH_M]);
        let back = (run.overhang_m == 0.0).then_some(-run.frame.out);
        self.worktops.push(Worktop { surface: Surface { low, high }, kind: run.kind, back });
    }

    /// Cabinets that fill a length, evenly.
    fn cabinets_below(&mut self, frame: Frame, along: Span) {
        let length = along[1] - along[0];
        if length < FILLER_WIDEST_M {
            if length > 0.001 {
                self.filler(frame, along);
            }
            return;
        }
        let count = libm::ceilf(length / CABINET_WIDEST_M).max(1.0);
        let width = length / count;
        for index in 0..count as u32 {
            let from = along[0] + index as f32 * width;
            self.cabinet_below(frame, [from, from + width]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use proto::random::{Key, Purpose};

    proptest! {
        #[test]
        fn a_run_is_filled_without_gaps(length_m in 1.0f32..6.0, seed in 0u64..1000) {
            let slot = |unit: Unit, least_m: f32| Slot { unit, least_m: least_m.max(unit.width_m()) };
            let slots = [
                slot(Unit::Fridge, 0.0),
                slot(Unit::Cabinets, 0.4),
                slot(Unit::Dishwasher, 0.0),
                slot(Unit::Cabinets, 0.5),
            ];
            let mut random =
                Key { seed, purpose: Purpose::Kitchen, kitchen: 0, environment: 0, episode: 0, step: 0 }.stream();
            let divided = divide(&slots, length_m, &mut random);
            prop_assert_eq!(divided.is_some(), length_m >= 0.78 + 0.9);
            let Some(units) = divided else { return Ok(()) };
            prop_assert!((units[units.len() - 1].along[1] - length_m).abs() < 1e-4);
            for pair in units.windows(2) {
                prop_assert_eq!(pair[0].along[1], pair[1].along[0]);
            }
            for placed in &units {
                let width = placed.along[1] - placed.along[0];
                prop_assert!(width >= placed.unit.width_m() - 1e-4);
                prop_assert!(placed.unit == Unit::Cabinets || width < placed.unit.width_m() + 1e-4);
            }
        }
    }
}
