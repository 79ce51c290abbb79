//! The floor: where the robot can drive with its arm held still.
//!
//! Turns of 45 degrees and ways of 0.2 m reach ever new positions; positions in one cell of a fine grid count as the
//! same, and the first that the search comes by stands for its cell.

use super::search::Graph;
use crate::robot::action::Action;
use crate::robot::configuration::{Configuration, MOVE_AHEAD_M};
use crate::robot::dimensions::{ARM_BASE_AHEAD_M, REACH_M};
use rapier3d::math::Vec3;

const CELL_M: f32 = 0.05;
/// Room about the room: keeps cell numbers positive, metres.
const ORIGIN_M: f32 = -50.0;

pub struct Floor<'a> {
    /// Whether nothing is in an action's way.
    pub passable: &'a dyn Fn(&Configuration, Action, &Configuration) -> bool,
    pub place: Vec3,
    /// How near to the place the wrist must come, metres on the floor plane.
    pub slack_m: f32,
    /// What has been tried and failed.
    pub forbidden: &'a [(Configuration, Action)],
}

impl Floor<'_> {
    /// Distance from the body's axis to the place on the floor plane, metres.
    fn distance_m(&self, at: &Configuration) -> f32 {
        let (x, z) = (self.place.x - at.x_m, self.place.z - at.z_m);
        f32::sqrt(x * x + z * z)
    }

    /// Whether the place lies before the robot and within reach: the arm itself may still find things in its way.
    pub fn faces_place(&self, at: &Configuration) -> bool {
        let (sin, cos) = libm::sincosf(at.yaw_rad());
        let (x, z) = (self.place.x - at.x_m, self.place.z - at.z_m);
        let (aside, ahead) = (x * cos - z * sin, x * sin + z * cos - ARM_BASE_AHEAD_M);
        ahead > -self.slack_m && f32::sqrt(aside * aside + ahead * ahead) <= REACH_M + self.slack_m
    }
}

impl Graph for Floor<'_> {
    type State = Configuration;

    fn key(&self, state: &Configuration) -> u64 {
        let cell = |at_m: f32| ((at_m - ORIGIN_M) / CELL_M) as u64;
        cell(state.x_m) << 32 | cell(state.z_m) << 8 | state.yaw_ticks as u64
    }

    fn successors(&self, state: &Configuration, out: &mut Vec<(Action, Configuration)>) {
        const DRIVING: [Action; 3] =
            [Action::MoveAheadContinuous, Action::RotateRightContinuous, Action::RotateLeftContinuous];
        out.extend(DRIVING.iter().filter_map(|&action| state.after(action).map(|next| (action, next))));
    }

    fn passable(&self, from: &Configuration, action: Action, to: &Configuration) -> bool {
        !self.forbidden.contains(&(*from, action)) && (self.passable)(from, action, to)
    }

    fn bound(&self, state: &Configuration) -> u32 {
        let left_m = self.distance_m(state) - (ARM_BASE_AHEAD_M + REACH_M + self.slack_m);
        // A hair less than whole, for rounding in positions that add up.
        libm::ceilf((left_m / MOVE_AHEAD_M).max(0.0) - 1e-3) as u32
    }
}

#[cfg(test)]
mod tests {
    use super::super::search::Search;
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    /// Fewest actions to a pose that faces the place, by trying everything: poses are told apart to the millimetre.
    fn fewest(floor: &Floor, start: Configuration, most: u32) -> Option<u32> {
        let millimetres =
            |at: &Configuration| ((at.x_m * 1e3).round() as i32, (at.z_m * 1e3).round() as i32, at.yaw_ticks);
        let mut seen = BTreeSet::from([millimetres(&start)]);
        let mut ring = vec![start];
        for cost in 0..=most {
            if ring.iter().any(|at| floor.faces_place(at)) {
                return Some(cost);
            }
            let mut next = Vec::new();
            for at in &ring {
                let mut successors = Vec::new();
                floor.successors(at, &mut successors);
                next.extend(successors.into_iter().map(|(_, to)| to).filter(|to| seen.insert(millimetres(to))));
            }
            ring = next;
        }
        None
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        #[test]
        fn on_an_empty_floor_the_way_is_the_shortest_and_its_actions_lead_along_it(
            x in -1.9f32..1.9, z in -1.9f32..1.9, yaw_ticks in 0..8, slack_m in 0.02f32..0.2,
        ) {
            let start = Configuration::start(0.1, -0.2, yaw_ticks);
            let floor = Floor {
                passable: &|_, _, _| true,
                place: Vec3::new(start.x_m + x, 0.9, start.z_m + z),
                slack_m,
                forbidden: &[],
            };
            let mut search = Search::new(&floor, start, 100_000);
            let index = loop {
                let index = search.next(&floor).unwrap();
                if floor.faces_place(search.state(index)) {
                    break index;
                }
            };
            let (cost, path) = (search.cost(index), search.path(index));
            prop_assert_eq!(path.len() as u32, cost);
            let mut at = start;
            for action in path {
                prop_assert!(floor.bound(&at) <= 1 + floor.bound(&at.after(action).unwrap()), "the bound is consistent");
                at = at.after(action).unwrap();
            }
            prop_assert_eq!(at, *search.state(index));
            // Positions of one cell stand for each other, which can cost one action.
            let least = fewest(&floor, start, cost).unwrap();
            prop_assert!(least <= cost && cost <= least + 1, "{} actions where {} do", cost, least);
        }

        #[test]
        fn what_is_forbidden_is_not_done(yaw_ticks in 0..8) {
            let start = Configuration::start(0.0, 0.0, yaw_ticks);
            let ahead = Action::MoveAheadContinuous;
            let floor = Floor {
                passable: &|from, action, _| action != ahead || *from != start,
                place: Vec3::new(1.0, 0.9, 1.0),
                slack_m: 0.1,
                forbidden: &[(start, Action::RotateLeftContinuous)],
            };
            let mut search = Search::new(&floor, start, 500);
            while let Some(index) = search.next(&floor) {
                let path = search.path(index);
                prop_assert!(path.first().is_none_or(|first| *first == Action::RotateRightContinuous));
            }
        }
    }
}
