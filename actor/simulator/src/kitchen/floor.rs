//! The free floor of a room as a grid of cells, and shortest ways on it.
//!
//! Ways go from a cell to any of its eight neighbours, diagonally past no corner. Lengths are whole numbers, so that they
//! are the same on every machine: a straight step is 70, a diagonal one 99, which is 70 √2 but for a ten-thousandth.

use crate::physics::fixed_scene::FixedScene;
use crate::robot::dimensions::{BODY_HEIGHT_M, BODY_RADIUS_M};
use rapier3d::geometry::Aabb;
use rapier3d::math::Vec3;
use rapier3d::parry::bounding_volume::BoundingVolume;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

pub(super) const CELL_M: f32 = 0.125;
/// Room that a robot position leaves about the body, metres.
pub(super) const CLEARANCE_M: f32 = 0.03;
/// Length of a step to a neighbour, and to a diagonal one.
const STRAIGHT: u32 = 70;
const DIAGONAL: u32 = 99;
/// Of a cell from which there is no way.
const NONE: u32 = u32::MAX;

/// A floor: cells in which the robot's body can stand, and others.
#[derive(Debug, Clone)]
pub struct Floor {
    low: Vec3,
    columns: usize,
    pub(super) free: Vec<bool>,
}

/// Length of the shortest way to one place from every cell.
#[derive(Debug, Clone)]
pub struct Ways(Vec<u32>);

impl Floor {
    /// The floor between two corners. A cell is free if the body, with some room, meets nothing there.
    pub(super) fn of((low, high): (Vec3, Vec3), scene: &FixedScene, movables: &[Aabb]) -> Self {
        let columns = ((high.x - low.x) / CELL_M) as usize;
        let rows = ((high.z - low.z) / CELL_M) as usize;
        let mut floor = Self { low, columns, free: Vec::new() };
        let is_free = |cell: usize| {
            let (x, z) = floor.position(cell);
            let reach = BODY_RADIUS_M + CLEARANCE_M;
            let body = Aabb::new(Vec3::new(x - reach, 0.01, z - reach), Vec3::new(x + reach, BODY_HEIGHT_M, z + reach));
            !scene.meets_aabb(&body) && !movables.iter().any(|other| other.intersects(&body))
        };
        floor.free = (0..columns * rows).map(is_free).collect();
        floor
    }

    /// Cells in a row: along x.
    pub(super) fn columns(&self) -> usize {
        self.columns
    }

    /// The middle of a cell, world x and z, metres.
    pub(super) fn position(&self, cell: usize) -> (f32, f32) {
        let (column, row) = (cell % self.columns, cell / self.columns);
        (self.low.x + (column as f32 + 0.5) * CELL_M, self.low.z + (row as f32 + 0.5) * CELL_M)
    }

    /// Column and row of the cell that a position is in, or would be.
    fn column_and_row(&self, (x_m, z_m): (f32, f32)) -> (i32, i32) {
        let cell = |from_low_m: f32| libm::floorf(from_low_m / CELL_M) as i32;
        (cell(x_m - self.low.x), cell(z_m - self.low.z))
    }

    fn cell(&self, column: i32, row: i32) -> Option<usize> {
        let rows = self.free.len() / self.columns;
        let inside = (0..self.columns as i32).contains(&column) && (0..rows as i32).contains(&row);
        inside.then(|| row as usize * self.columns + column as usize)
    }

    /// The free cells to which one step leads, with their columns, rows, and the step's length.
    fn steps(&self, column: i32, row: i32) -> impl Iterator<Item = (usize, i32, i32, u32)> {
        let free = move |column, row| self.cell(column, row).filter(|&cell| self.free[cell]);
        let about = [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)];
        about.into_iter().filter_map(move |(x, z)| {
            let is_open = free(column + x, row).is_some() && free(column, row + z).is_some();
            let length = if x != 0 && z != 0 { DIAGONAL } else { STRAIGHT };
            free(column + x, row + z)
                .filter(|_| length == STRAIGHT || is_open)
                .map(|cell| (cell, column + x, row + z, length))
        })
    }

    /// The shortest ways to a position on this floor (Dijkstra 1959).
    pub fn ways_to(&self, to: (f32, f32)) -> Ways {
        let mut lengths = vec![NONE; self.free.len()];
        let (column, row) = self.column_and_row(to);
        let mut open = BinaryHeap::new();
        if let Some(cell) = self.cell(column, row) {
            lengths[cell] = 0;
            open.push(Reverse((0, column, row)));
        }
        while let Some(Reverse((length, column, row))) = open.pop() {
            if self.cell(column, row).is_some_and(|cell| lengths[cell] < length) {
                continue;
            }
            for (next, column, row, step) in self.steps(column, row) {
                if length + step < lengths[next] {
                    lengths[next] = length + step;
                    open.push(Reverse((length + step, column, row)));
                }
            }
        }
        Ways(lengths)
    }

    /// Length of the way from a position, metres: to the middle of a cell about it and on from there, whichever is
    /// shortest. Infinite if there is none.
    pub fn way_m(&self, ways: &Ways, from: (f32, f32)) -> f32 {
        const METRES: f32 = CELL_M / STRAIGHT as f32;
        const ASIDE: f32 = (DIAGONAL - STRAIGHT) as f32 / STRAIGHT as f32;
        let (column, row) = self.column_and_row(from);
        let through = |cell: usize| {
            let (x_m, z_m) = self.position(cell);
            let (x_m, z_m) = ((x_m - from.0).abs(), (z_m - from.1).abs());
            ways.0[cell] as f32 * METRES + x_m.max(z_m) + ASIDE * x_m.min(z_m)
        };
        let there = |&cell: &usize| ways.0[cell] != NONE;
        if let Some(cell) = self.cell(column, row).filter(there) {
            let about = self.steps(column, row).map(|(cell, ..)| through(cell));
            return about.fold(through(cell), f32::min);
        }
        // The robot stands nearer to something than a cell allows: the way leads over the nearest cells that do.
        let about = |reach: i32| {
            let cells = (-reach..=reach).flat_map(|z| (-reach..=reach).map(move |x| (x, z)));
            let cells = cells.filter_map(|(x, z)| self.cell(column + x, row + z)).filter(there);
            cells.map(through).min_by(f32::total_cmp)
        };
        (1..=self.free.len() as i32).find_map(about).unwrap_or(f32::INFINITY)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SIDE: usize = 9;

    fn floor(free: Vec<bool>) -> Floor {
        Floor { low: Vec3::new(-1.0, 0.0, 2.0), columns: SIDE, free }
    }

    /// Lengths by plain relaxation: every cell looks at its neighbours until nothing changes.
    fn relaxed(floor: &Floor, to: usize) -> Vec<u32> {
        let mut lengths = vec![NONE; SIDE * SIDE];
        lengths[to] = 0;
        loop {
            let before = lengths.clone();
            for cell in (0..SIDE * SIDE).filter(|&cell| floor.free[cell] && cell != to) {
                let (x, z) = (cell % SIDE, cell / SIDE);
                for other in 0..SIDE * SIDE {
                    let (other_x, other_z) = (other % SIDE, other / SIDE);
                    let corners_free = floor.free[z * SIDE + other_x] && floor.free[other_z * SIDE + x];
                    let step = match (x.abs_diff(other_x), z.abs_diff(other_z)) {
                        (1, 0) | (0, 1) => 70,
                        (1, 1) if corners_free => 99,
                        _ => continue,
                    };
                    lengths[cell] = lengths[cell].min(lengths[other].saturating_add(step));
                }
            }
            if lengths == before {
                return lengths;
            }
        }
    }

    proptest! {
        #[test]
        fn ways_are_as_short_as_by_relaxation(
            mut free in proptest::collection::vec(proptest::bool::weighted(0.7), SIDE * SIDE), to in 0..SIDE * SIDE,
        ) {
            free[to] = true;
            let floor = floor(free);
            let ways = floor.ways_to(floor.position(to));
            prop_assert_eq!(&ways.0, &relaxed(&floor, to));
            for cell in (0..SIDE * SIDE).filter(|&cell| ways.0[cell] != NONE) {
                let way_m = floor.way_m(&ways, floor.position(cell));
                prop_assert!((way_m - ways.0[cell] as f32 / 70.0 * 0.125).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn between_the_middles_of_cells_the_way_is_as_long_as_on_an_open_floor() {
        let floor = floor(vec![true; SIDE * SIDE]);
        let to = floor.position(4 * SIDE + 1);
        let ways = floor.ways_to(to);
        for (x_m, z_m, way_m) in
            [(0.51, 0.0, 0.51), (0.3, 0.3, 0.3 * 2.0f32.sqrt()), (0.5, 0.2, 0.3 + 0.2 * 2.0f32.sqrt())]
        {
            assert!((floor.way_m(&ways, (to.0 + x_m, to.1 - z_m)) - way_m).abs() < 1e-4, "{x_m} m, {z_m} m");
        }
        let free = (0..SIDE * SIDE).map(|cell| cell % SIDE != 4 || cell / SIDE == 0).collect();
        let (walled, beyond) = (Floor { free, ..floor.clone() }, floor.position(4 * SIDE + 7));
        let [open_m, about_m] = [&floor, &walled].map(|floor| floor.way_m(&floor.ways_to(to), beyond));
        assert!(open_m == 0.75 && about_m > 1.25, "{open_m} m, {about_m} m about the wall");
    }
}
