//! How far two rooms are apart, and the rule that keeps procedural kitchens away from those of validation and test.
//!
//! Two rooms are compared by what is built in: counters, cabinets, appliances, tables, shelves, windows; not walls,
//! floor and ceiling, and not what stands about. Space is divided into cells of 0.1 m × 0.1 m × 0.2 m about the room's
//! middle, and a cell is taken if the bounding box of a part meets it. The distance is Jaccard's, 1 - |A ∩ B| / |A ∪ B|,
//! the least over the eight ways to turn and mirror one of the rooms: 0 is the same room, 1 has nothing at the same
//! place.

use super::draw::draw_fitted;
use super::kitchen_key::KitchenKey;
use super::layout::FittedRoom;
use super::settled::Kitchen;
use crate::physics::geometry::Solid;
use crate::shape::Shape;
use proto::kitchen::{KitchenId, Split};
use rapier3d::math::{Pose3, Vec3};
use std::sync::LazyLock;

/// Side of a cell on the floor plane, and its height, metres.
const CELL_M: f32 = 0.1;
const LAYER_M: f32 = 0.2;
/// Cells along each side; the largest room has 96.
const SIDE: usize = 104;
/// Layers, one bit each: 3.2 m.
const LAYERS: usize = 16;

/// Draws that the kitchens of validation and test came out of: kitchen, attempt. A test compares them with the kitchens
/// themselves.
pub const DRAWN_AT: [(u32, u32); 10] =
    [(2, 0), (5, 0), (8, 0), (11, 0), (14, 0), (17, 0), (20, 1), (23, 0), (26, 0), (29, 1)];

/// Which cells are taken by what is built in.
#[derive(Clone, PartialEq, Eq)]
struct Footprint {
    /// Layers of each cell, row-major.
    cells: Vec<u16>,
}

impl Footprint {
    fn of(room: &FittedRoom) -> Self {
        let built_in = room.fixtures.iter().map(|fixture| (fixture.category.as_str(), &fixture.shape, &fixture.pose));
        Self::around(0.5 * (room.floor.low + room.floor.high), built_in)
    }

    /// Of fixed bodies, each with category, shape and pose, about the middle of their room.
    fn around<'a>(middle: Vec3, built_in: impl Iterator<Item = (&'a str, &'a Shape, &'a Pose3)>) -> Self {
        let mut cells = vec![0; SIDE * SIDE];
        let index = |metres: f32, step_m: f32, zero: f32, count: usize| {
            let cell = libm::floorf(metres / step_m + zero);
            (cell.max(0.0) as usize).min(count - 1)
        };
        let span = |low, high, step_m, zero, count| index(low, step_m, zero, count)..=index(high, step_m, zero, count);
        let half = 0.5 * SIDE as f32;
        for (category, shape, pose) in built_in {
            if matches!(category, "Floor" | "Wall" | "Ceiling") {
                continue;
            }
            for (part, body_from_part) in &Solid::of(shape).parts {
                let aabb = part.compute_aabb(&(*pose * *body_from_part));
                let (low, high) = (aabb.mins - middle, aabb.maxs - middle);
                let layers = span(low.y, high.y, LAYER_M, 0.0, LAYERS).fold(0u16, |bits, layer| bits | 1 << layer);
                for row in span(low.z, high.z, CELL_M, half, SIDE) {
                    for column in span(low.x, high.x, CELL_M, half, SIDE) {
                        cells[row * SIDE + column] |= layers;
                    }
                }
            }
        }
        Self { cells }
    }

    /// How far two are apart, 0 to 1.
    fn distance(&self, other: &Self) -> f32 {
        (0..8).map(|way| self.distance_turned(other, way)).fold(1.0, f32::min)
    }

    /// The same for one of the eight ways to lay the other one.
    fn distance_turned(&self, other: &Self, way: usize) -> f32 {
        let (mut both, mut either) = (0, 0);
        for row in 0..SIDE {
            for column in 0..SIDE {
                let (mut r, mut c) = (row, column);
                if way & 1 != 0 {
                    r = SIDE - 1 - r;
                }
                if way & 2 != 0 {
                    c = SIDE - 1 - c;
                }
                if way & 4 != 0 {
                    (r, c) = (c, r);
                }
                let (a, b) = (self.cells[row * SIDE + column], other.cells[r * SIDE + c]);
                both += (a & b).count_ones();
                either += (a | b).count_ones();
            }
        }
        1.0 - both as f32 / either.max(1) as f32
    }
}

/// The kitchens of validation and test, and how near the nearest two of them are.
struct Kept {
    footprints: Vec<(KitchenId, Footprint)>,
    least: f32,
}

static KEPT: LazyLock<Kept> = LazyLock::new(|| {
    let of = |&(number, attempt): &(u32, u32)| {
        let id = KitchenId::built_in(number).ok().filter(|id| id.split() != Split::Train)?;
        Some((id, Footprint::of(&draw_fitted(KitchenKey::from(id), attempt).ok()?.0)))
    };
    let footprints: Vec<(KitchenId, Footprint)> = DRAWN_AT.iter().filter_map(of).collect();
    let mut least = 1.0_f32;
    for (index, (_, one)) in footprints.iter().enumerate() {
        for (_, other) in &footprints[..index] {
            least = least.min(one.distance(other));
        }
    }
    Kept { footprints, least }
});

/// Distance of the nearest two kitchens of validation and test. No procedural kitchen is nearer to one of them.
pub fn least_distance() -> f32 {
    KEPT.least
}

/// The kitchen of validation and test that a room is most like, and how far it is from it; none if there are none.
pub(super) fn nearest(room: &FittedRoom) -> Option<(KitchenId, f32)> {
    nearest_to(&Footprint::of(room))
}

pub fn nearest_to_kitchen(kitchen: &Kitchen) -> Option<(KitchenId, f32)> {
    let bodies = kitchen.static_bodies().map(|index| (&kitchen.bodies()[index], &kitchen.settled_poses()[index]));
    let middle = 0.5 * (kitchen.floor.0 + kitchen.floor.1);
    nearest_to(&Footprint::around(middle, bodies.map(|(body, pose)| (body.category.as_str(), &body.shape, pose))))
}

fn nearest_to(own: &Footprint) -> Option<(KitchenId, f32)> {
    let distances = KEPT.footprints.iter().map(|(id, footprint)| (*id, own.distance(footprint)));
    distances.min_by(|(_, a), (_, b)| a.total_cmp(b))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn room(number: u32) -> FittedRoom {
        let id = KitchenId::new(number).unwrap();
        (0..32).find_map(|attempt| Some(draw_fitted(KitchenKey::from(id), attempt).ok()?.0)).unwrap()
    }

    #[test]
    fn a_room_is_like_itself_however_it_is_turned() {
        let room = room(3);
        let own = Footprint::of(&room);
        assert_eq!(own.distance(&own), 0.0);
        for way in 0..8 {
            let turned = |row: usize, column: usize| {
                let (r, c) = if way & 4 != 0 { (column, row) } else { (row, column) };
                let r = if way & 1 != 0 { SIDE - 1 - r } else { r };
                let c = if way & 2 != 0 { SIDE - 1 - c } else { c };
                own.cells[r * SIDE + c]
            };
            let cells = (0..SIDE * SIDE).map(|cell| turned(cell / SIDE, cell % SIDE)).collect();
            assert_eq!(own.distance(&Footprint { cells }), 0.0, "{way}");
        }
        assert!(own.distance(&Footprint::of(&self::room(6))) > 0.3);
    }

    #[test]
    fn the_ten_are_all_there_and_apart() {
        assert_eq!(KEPT.footprints.len(), 10);
        assert!((0.3..0.95).contains(&least_distance()), "{}", least_distance());
        // What is nearest to one of them is itself.
        let (number, attempt) = DRAWN_AT[4];
        let id = KitchenId::new(number).unwrap();
        let room = draw_fitted(KitchenKey::from(id), attempt).unwrap().0;
        assert_eq!(nearest(&room), Some((id, 0.0)));
    }
}
