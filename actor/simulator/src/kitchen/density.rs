//! Density of movable things: every figure that decides how crowded a kitchen is, in one place.
//!
//! The figures are calibrated, not derived: the tests of all kitchens compare the outcome with iTHOR's, and the
//! oracle's share of episodes without disturbance shows whether the task has the intended difficulty. Change them here,
//! then look at both.

use super::catalogue::Place;

/// A thing is set down at that distance from its nearest neighbour which a draw from this distribution asks for, as
/// far as the kitchen allows: deciles from the 0th to the 10th, metres. Later things come between earlier ones, so this
/// is wider than the distribution that results.
pub const COMPANY_M: [f32; 11] = [0.06, 0.10, 0.14, 0.19, 0.25, 0.33, 0.42, 0.54, 0.70, 1.0, 1.8];
/// That distribution belongs to a kitchen with this area of surfaces, square metres; ...
pub const USUAL_AREA_M2: f32 = 4.0;
/// ... in others it is wider or narrower as the root of the area, within these bounds: a small kitchen is crowded in
/// places, not everywhere.
pub const SPREAD: [f32; 2] = [0.5, 1.5];
/// Places that are compared for the wanted distance.
pub const CANDIDATES: u32 = 40;
/// Draws of places, free or not, before the best so far is taken or the kitchen is given up.
pub const TRIES: u32 = 900;
pub const GAP_M: f32 = 0.012;
/// Distance of a thing's bounding box from the edge of what it stands on, metres.
pub const EDGE_M: f32 = 0.012;
/// People put things at the back of a counter: the distance from the front is the depth times the root of a uniform
/// number of this order; 1 would be no preference.
pub const BACKWARDS: f32 = 1.5;
/// Things of the sink and of the stove lie about this far from it, metres.
pub const BESIDE_M: f32 = 0.45;
pub const ON_BURNER_SHARE: f32 = 0.4;
/// Most things of categories that iTHOR does not have; the number is drawn from 0 to this.
pub const EXTRAS_MOST: u32 = 4;

/// Weight of a square metre of each kind of surface for things of a class: counter, island, dining table, side table,
/// shelf, basin.
pub fn preference(place: Place) -> [f32; 6] {
    match place {
        Place::Counter => [1.0, 0.7, 0.1, 0.5, 0.1, 0.0],
        Place::Table => [0.4, 1.0, 2.0, 1.0, 0.2, 0.0],
        Place::Shelf => [0.3, 0.2, 0.1, 1.0, 4.0, 0.0],
        Place::Sink => [1.0, 0.2, 0.0, 0.0, 0.0, 3.0],
        Place::Surface | Place::Stove | Place::Seat | Place::Floor => [1.0, 0.9, 0.6, 1.0, 1.3, 0.8],
    }
}

/// Distance of a chair's middle from the table's edge, least and most, metres.
pub const CHAIR_OUT_M: [f32; 2] = [0.06, 0.28];
pub const CHAIR_TURN_RAD: f32 = 0.2;
/// Distance of a bin's middle from the wall, metres, beyond its own half.
pub const BIN_OUT_M: f32 = 0.03;
