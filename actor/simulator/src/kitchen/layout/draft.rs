//! A layout in the making: what has been built so far, and the style that all of it shares.

use super::floor_plan::{FloorPlan, Rectangle};
use super::frame::{Assembly, Span};
use super::wall::Wall;
use crate::kitchen::room::{Fixture, Surface};
use proto::random::Random;
use rapier3d::math::Vec3;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WorktopKind {
    Counter,
    /// An island or a peninsula.
    Island,
    Table,
    SideTable,
    Shelf,
    /// The bottom of the sink's basin.
    Basin,
}

#[derive(Debug, Clone, Copy)]
pub struct Worktop {
    pub surface: Surface,
    pub kind: WorktopKind,
    /// Unit vector towards the wall behind it, if there is one.
    pub back: Option<Vec3>,
}

#[derive(Debug, Clone, Copy)]
pub struct Seat {
    /// On the edge of the table or counter, on the floor.
    pub edge: Vec3,
    /// Unit vector from the edge towards the table.
    pub facing: Vec3,
    /// Whether it is a counter's: stools only.
    pub at_counter: bool,
}

/// What all fixtures of a kitchen share.
#[derive(Debug, Clone, Copy)]
pub(super) struct Style {
    pub counter_height_m: f32,
    pub slab_m: f32,
    /// Height of the wall cabinets' lower and upper edge, metres.
    pub wall_cabinet_m: Span,
    /// Whether doors and drawers have knobs; bars otherwise.
    pub knobs: bool,
    pub toe_kick_m: f32,
}

pub(super) struct Draft<'a> {
    pub random: &'a mut Random,
    pub style: Style,
    pub walls: [Wall; 4],
    pub fixtures: Vec<Fixture>,
    pub tops: Vec<Assembly>,
    pub worktops: Vec<Worktop>,
    pub seats: Vec<Seat>,
    pub burners: Vec<Vec3>,
    pub sink: Option<Vec3>,
    pub floor_plan: FloorPlan,
    pub before_door: Rectangle,
    /// Drawers that are still to be built.
    pub drawers: u32,
    pub burner_count: u32,
}

impl Style {
    pub fn draw(random: &mut Random) -> Self {
        let counter_height_m = 0.88 + 0.02 * random.below(5) as f32;
        let bottom = counter_height_m + random.range(0.52, 0.58);
        Self {
            counter_height_m,
            slab_m: [0.03, 0.04][random.below(2) as usize],
            wall_cabinet_m: [bottom, bottom + random.range(0.62, 0.75)],
            knobs: random.uniform() < 0.4,
            toe_kick_m: random.range(0.09, 0.12),
        }
    }
}

impl Draft<'_> {
    /// Puts a finished body into the room.
    pub fn fix(&mut self, category: &str, body: Assembly) {
        self.fixtures.push(body.fixture(category));
    }
}
