//! The room: walls, runs of counters with their fixtures, table and island. Everything here is fixed.
//!
//! A run is a row of 0.6 m modules along a wall. Which walls have runs is the plan: one wall, L, U, galley, or one
//! wall with an island. Modules become cabinets with drawers under a counter top, or fridge, sink and stove; above
//! them hang cabinets. What is left free on top is where small things stand.

use super::room::{Fixture, Surface};
use crate::shape::{Part, Primitive, Shape};
use proto::random::Random;
use rapier3d::math::{Pose3, Vec3};

/// Height of a counter's top, metres.
const COUNTER_HEIGHT_M: f32 = 0.9;
const COUNTER_DEPTH_M: f32 = 0.62;
const SLAB_M: f32 = 0.04;
const MODULE_M: f32 = 0.6;
const CABINET_BOTTOM_M: f32 = 1.45;
const CABINET_TOP_M: f32 = 2.15;
const CABINET_DEPTH_M: f32 = 0.33;
const ROOM_HEIGHT_M: f32 = 2.6;
const WALL_M: f32 = 0.2;
const TABLE_HEIGHT_M: f32 = 0.75;
/// Thickness of a shelf. With the hand's radius it exceeds the magnet's reach: nothing is picked up through a shelf.
const SHELF_M: f32 = 0.03;

/// The room and what is fixed in it.
#[derive(Debug, Clone, Default)]
pub struct Layout {
    /// Fixed bodies, in the order they were put in.
    pub fixtures: Vec<Fixture>,
    /// Where small things stand.
    pub surfaces: Vec<Surface>,
    /// Free floor: inside of the walls, metres (y is 0).
    pub floor: Option<(Vec3, Vec3)>,
    /// Middle and half size of the dining table, if there is one.
    pub table: Option<(Vec3, Vec3)>,
}

/// Which walls carry runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Plan {
    OneWall,
    Ell,
    You,
    Galley,
    Island,
}

/// One wall's coordinates: `along` runs beside it, `out` into the room.
#[derive(Clone, Copy)]
struct Frame {
    origin: Vec3,
    along: Vec3,
    out: Vec3,
}

/// What one module of a run is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Module {
    Counter,
    Fridge,
    Sink,
    Stove,
}

impl Layout {
    /// Draws a room.
    pub fn draw(random: &mut Random) -> Self {
        let plan = [Plan::Ell, Plan::You, Plan::Galley, Plan::Island, Plan::OneWall][random.below(5) as usize];
        let long_wall = plan == Plan::OneWall || plan == Plan::Island;
        let width = if long_wall { random.range(4.4, 5.6) } else { random.range(3.6, 5.0) };
        let depth = if plan == Plan::Galley { random.range(3.9, 5.4) } else { random.range(4.0, 5.4) };
        let has_table = plan != Plan::Island && (long_wall || random.uniform() < 0.5);
        let mut layout = Self::default();
        layout.room(width, depth, random);
        let (half_x, half_z) = (0.5 * width, 0.5 * depth);
        let north = Frame { origin: Vec3::new(-half_x, 0.0, half_z), along: Vec3::X, out: Vec3::NEG_Z };
        let south = Frame { origin: Vec3::new(-half_x, 0.0, -half_z), along: Vec3::X, out: Vec3::Z };
        // A side wall's run begins where the north wall's run ends.
        let below = half_z - COUNTER_DEPTH_M;
        let west = Frame { origin: Vec3::new(-half_x, 0.0, below), along: Vec3::NEG_Z, out: Vec3::X };
        let east = Frame { origin: Vec3::new(half_x, 0.0, below), along: Vec3::NEG_Z, out: Vec3::NEG_X };
        let modules = |length_m: f32| (length_m / MODULE_M) as usize;
        let (whole, side) = (modules(width), modules(depth - COUNTER_DEPTH_M - 1.0).min(4));
        let runs: Vec<(Frame, Vec<Module>)> = match plan {
            Plan::OneWall | Plan::Island => {
                let mut row = vec![Module::Counter; whole];
                row[0] = Module::Fridge;
                row[whole - 2] = Module::Sink;
                row[whole / 2 - 1] = Module::Stove;
                vec![(north, row)]
            }
            Plan::Ell | Plan::You => {
                let mut row = vec![Module::Counter; whole];
                row[whole / 2] = Module::Sink;
                let mut first = vec![Module::Counter; side];
                first[side - 1] = Module::Fridge;
                let mut second = vec![Module::Counter; side];
                if plan == Plan::You {
                    second[side / 2] = Module::Stove;
                    vec![(north, row), (west, first), (east, second)]
                } else {
                    first[side / 2 - 1] = Module::Stove;
                    vec![(north, row), (west, first)]
                }
            }
            Plan::Galley => {
                let mut row = vec![Module::Counter; whole];
                row[whole / 2] = Module::Sink;
                let mut opposite = vec![Module::Counter; whole.min(5)];
                opposite[0] = Module::Fridge;
                opposite[2] = Module::Stove;
                vec![(north, row), (south, opposite)]
            }
        };
        for (frame, row) in &runs {
            layout.run(*frame, row);
        }
        let middle_z = if plan == Plan::Galley { 0.0 } else { -0.31 };
        if plan == Plan::Island {
            layout.island(Vec3::new(0.0, 0.0, middle_z), random);
        } else if has_table {
            // Where the floor is widest between the runs.
            let x = if plan == Plan::Ell { 0.31 } else { 0.0 };
            layout.dining_table(Vec3::new(x, 0.0, middle_z - 0.2), random);
        }
        if !has_table || random.uniform() < 0.4 {
            layout.shelving_unit(width, depth, plan);
        }
        layout
    }

    fn fix(&mut self, category: &str, shape: Shape, position: Vec3) {
        self.fixtures.push(Fixture { category: category.to_owned(), shape, pose: Pose3::from_translation(position) });
    }

    fn add(&mut self, category: &'static str, low: Vec3, high: Vec3) {
        let shape = Shape::of(Primitive::Cuboid { half_extents_m: 0.5 * (high - low) });
        self.fix(category, shape, 0.5 * (low + high));
    }

    /// Adds one body made of several boxes.
    fn add_union(&mut self, category: &'static str, boxes: &[(Vec3, Vec3)]) {
        let position = 0.5 * (boxes[0].0 + boxes[0].1);
        let parts = boxes
            .iter()
            .map(|&(low, high)| Part {
                primitive: Primitive::Cuboid { half_extents_m: 0.5 * (high - low) },
                body_from_part: Pose3::from_translation(0.5 * (low + high) - position),
            })
            .collect();
        self.fix(category, Shape { parts }, position);
    }

    fn room(&mut self, width: f32, depth: f32, random: &mut Random) {
        let (x, z, t, h) = (0.5 * width, 0.5 * depth, WALL_M, ROOM_HEIGHT_M);
        self.add("Floor", Vec3::new(-x - t, -0.3, -z - t), Vec3::new(x + t, 0.0, z + t));
        self.add("Wall", Vec3::new(-x - t, 0.0, z), Vec3::new(x + t, h, z + t));
        self.add("Wall", Vec3::new(-x - t, 0.0, -z - t), Vec3::new(x + t, h, -z));
        self.add("Wall", Vec3::new(-x - t, 0.0, -z), Vec3::new(-x, h, z));
        self.add("Wall", Vec3::new(x, 0.0, -z), Vec3::new(x + t, h, z));
        self.add("Ceiling", Vec3::new(-x - t, h, -z - t), Vec3::new(x + t, h + t, z + t));
        let switch = random.range(-0.3, 0.3) * depth;
        self.add("LightSwitch", Vec3::new(x - 0.012, 1.3, switch - 0.04), Vec3::new(x, 1.42, switch + 0.04));
        self.floor = Some((Vec3::new(-x, 0.0, -z), Vec3::new(x, 0.0, z)));
    }

    fn run(&mut self, frame: Frame, row: &[Module]) {
        let mut counter_from: Option<f32> = None;
        for (index, &module) in row.iter().enumerate() {
            let from = index as f32 * MODULE_M;
            let to = from + MODULE_M;
            if module == Module::Counter {
                counter_from.get_or_insert(from);
                self.cabinet_below(frame, from, to, index % 2 == 0);
            } else {
                if let Some(start) = counter_from.take() {
                    self.counter_top(frame, start, from);
                }
                match module {
                    Module::Fridge => self.fridge(frame, from, to),
                    Module::Sink => self.sink(frame, from, to),
                    Module::Stove => self.stove(frame, from, to),
                    Module::Counter => {}
                }
            }
        }
        if let Some(start) = counter_from {
            self.counter_top(frame, start, row.len() as f32 * MODULE_M);
        }
    }

    fn counter_top(&mut self, frame: Frame, from: f32, to: f32) {
        let (low, high) = frame.block(from, to, COUNTER_HEIGHT_M - SLAB_M, COUNTER_HEIGHT_M, 0.0, COUNTER_DEPTH_M);
        self.add("CounterTop", low, high);
        self.surfaces.push(Surface {
            low: Vec3::new(low.x, COUNTER_HEIGHT_M, low.z),
            high: Vec3::new(high.x, CABINET_BOTTOM_M, high.z),
        });
        // Wall cabinets are two modules wide where there is room.
        let mut at = from;
        while at < to - 0.01 {
            let end = to.min(at + 2.0 * MODULE_M);
            self.cabinet_above(frame, at, end);
            at = end;
        }
    }

    fn cabinet_below(&mut self, frame: Frame, from: f32, to: f32, has_drawer: bool) {
        let top = COUNTER_HEIGHT_M - SLAB_M;
        let door_top = if has_drawer { 0.68 } else { top - 0.01 };
        let door = frame.block(from + 0.01, to - 0.01, 0.1, door_top, 0.56, 0.58);
        self.add_union("Cabinet", &[frame.block(from, to, 0.0, top, 0.0, 0.56), door]);
        if !has_drawer {
            return;
        }
        let handle = 0.5 * (from + to);
        self.add_union(
            "Drawer",
            &[
                frame.block(from + 0.01, to - 0.01, 0.70, top - 0.01, 0.56, 0.58),
                frame.block(handle - 0.08, handle + 0.08, 0.77, 0.785, 0.58, 0.60),
            ],
        );
    }

    fn cabinet_above(&mut self, frame: Frame, from: f32, to: f32) {
        let handle = to - 0.06;
        self.add_union(
            "Cabinet",
            &[
                frame.block(from, to, CABINET_BOTTOM_M, CABINET_TOP_M, 0.0, CABINET_DEPTH_M),
                frame.block(handle - 0.01, handle + 0.01, 1.5, 1.62, CABINET_DEPTH_M, CABINET_DEPTH_M + 0.025),
            ],
        );
    }

    fn fridge(&mut self, frame: Frame, from: f32, to: f32) {
        self.add_union(
            "Fridge",
            &[frame.block(from, to, 0.0, 1.8, 0.0, 0.66), frame.block(to - 0.07, to - 0.045, 0.7, 1.5, 0.66, 0.70)],
        );
    }

    fn sink(&mut self, frame: Frame, from: f32, to: f32) {
        let (top, bottom) = (COUNTER_HEIGHT_M, COUNTER_HEIGHT_M - 0.18);
        self.add_union(
            "Sink",
            &[
                frame.block(from, to, bottom - 0.04, bottom, 0.0, COUNTER_DEPTH_M),
                frame.block(from, to, bottom, top, 0.0, 0.12),
                frame.block(from, to, bottom, top, 0.54, COUNTER_DEPTH_M),
                frame.block(from, from + 0.06, bottom, top, 0.12, 0.54),
                frame.block(to - 0.06, to, bottom, top, 0.12, 0.54),
            ],
        );
        self.add(
            "Cabinet",
            frame.block(from, to, 0.0, bottom - 0.04, 0.0, 0.56).0,
            frame.block(from, to, 0.0, bottom - 0.04, 0.0, 0.56).1,
        );
        let middle = 0.5 * (from + to);
        self.add_union(
            "Faucet",
            &[
                frame.block(middle - 0.02, middle + 0.02, top, top + 0.26, 0.04, 0.08),
                frame.block(middle - 0.015, middle + 0.015, top + 0.23, top + 0.26, 0.08, 0.24),
                frame.block(middle + 0.05, middle + 0.08, top, top + 0.06, 0.04, 0.07),
            ],
        );
        let (low, high) = frame.block(from - 0.1, to + 0.1, 1.15, 2.05, 0.0, 0.02);
        self.add("Window", low, high);
    }

    fn stove(&mut self, frame: Frame, from: f32, to: f32) {
        let (low, high) = frame.block(from, to, 0.0, COUNTER_HEIGHT_M, 0.0, COUNTER_DEPTH_M);
        self.add("StoveOven", low, high);
        for burner in 0..4 {
            let along = from + 0.16 + 0.28 * (burner % 2) as f32;
            let out = 0.18 + 0.27 * (burner / 2) as f32;
            let disc = Shape::of(Primitive::Cylinder { radius_m: 0.09, half_height_m: 0.006 });
            self.fix("StoveBurner", disc, frame.at(along, COUNTER_HEIGHT_M + 0.006, out));
            let knob = from + 0.12 + 0.12 * burner as f32;
            let (low, high) =
                frame.block(knob - 0.02, knob + 0.02, 0.79, 0.83, COUNTER_DEPTH_M, COUNTER_DEPTH_M + 0.025);
            self.add("StoveKnob", low, high);
        }
        // The microwave hangs above the stove.
        let (low, high) = frame.block(from, to, CABINET_BOTTOM_M, 1.85, 0.0, 0.38);
        self.add("Microwave", low, high);
        let (low, high) = frame.block(from, to, 1.85, CABINET_TOP_M, 0.0, CABINET_DEPTH_M);
        self.add("Cabinet", low, high);
    }

    fn island(&mut self, middle: Vec3, random: &mut Random) {
        let half = Vec3::new(0.5 * random.range(1.3, 1.8), 0.0, 0.4);
        let top = Vec3::new(0.0, COUNTER_HEIGHT_M - SLAB_M, 0.0);
        self.add("Cabinet", middle - half * 0.85, middle + half * 0.85 + top);
        let (low, high) = (middle - half + top, middle + half + Vec3::new(0.0, COUNTER_HEIGHT_M, 0.0));
        self.add("CounterTop", low, high);
        self.surfaces.push(Surface {
            low: Vec3::new(low.x, COUNTER_HEIGHT_M, low.z),
            high: Vec3::new(high.x, ROOM_HEIGHT_M, high.z),
        });
    }

    fn dining_table(&mut self, middle: Vec3, random: &mut Random) {
        let half = Vec3::new(0.5 * random.range(1.1, 1.4), 0.0, 0.5 * random.range(0.75, 0.9));
        let up = |y: f32| Vec3::new(0.0, y, 0.0);
        let mut boxes = vec![(middle - half + up(TABLE_HEIGHT_M - SLAB_M), middle + half + up(TABLE_HEIGHT_M))];
        for (sign_x, sign_z) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
            let foot = middle + Vec3::new(sign_x * (half.x - 0.06), 0.0, sign_z * (half.z - 0.06));
            let leg = Vec3::new(0.03, 0.0, 0.03);
            boxes.push((foot - leg, foot + leg + up(TABLE_HEIGHT_M - SLAB_M)));
        }
        self.add_union("DiningTable", &boxes);
        self.surfaces
            .push(Surface { low: middle - half + up(TABLE_HEIGHT_M), high: middle + half + up(ROOM_HEIGHT_M) });
        self.table = Some((middle, half));
    }

    /// Open shelves against the south wall (the east wall's end in a galley).
    fn shelving_unit(&mut self, width: f32, depth: f32, plan: Plan) {
        let x = 0.5 * width - 0.5;
        let z = -0.5 * depth;
        let (low, high) = if plan == Plan::Galley {
            return;
        } else {
            (Vec3::new(x - 0.4, 0.0, z), Vec3::new(x + 0.4, 0.0, z + 0.35))
        };
        let side = |from: f32, to: f32| (Vec3::new(from, 0.0, low.z), Vec3::new(to, 1.2, high.z));
        self.add_union("ShelvingUnit", &[side(low.x, low.x + 0.02), side(high.x - 0.02, high.x)]);
        for (index, y) in [0.45, 0.85, 1.2].into_iter().enumerate() {
            let (shelf_low, shelf_high) =
                (Vec3::new(low.x + 0.02, y - SHELF_M, low.z), Vec3::new(high.x - 0.02, y, high.z));
            self.add("Shelf", shelf_low, shelf_high);
            let ceiling = [0.85 - SHELF_M, 1.2 - SHELF_M, ROOM_HEIGHT_M][index];
            self.surfaces.push(Surface {
                low: Vec3::new(shelf_low.x, y, shelf_low.z),
                high: Vec3::new(shelf_high.x, ceiling, shelf_high.z),
            });
        }
    }
}

impl Frame {
    fn at(self, along: f32, up: f32, out: f32) -> Vec3 {
        self.origin + along * self.along + out * self.out + Vec3::new(0.0, up, 0.0)
    }

    /// World corners of a box given in the wall's coordinates.
    fn block(self, from: f32, to: f32, bottom: f32, top: f32, out_from: f32, out_to: f32) -> (Vec3, Vec3) {
        let (a, b) = (self.at(from, bottom, out_from), self.at(to, top, out_to));
        (a.min(b), a.max(b))
    }
}
