//! The room: walls, runs of counters with their fixtures, tables and shelves. Everything here is fixed.
//!
//! ```text
//! plan        size and plan of a kitchen, order of the units in its runs
//! run         how a run's length is divided; counter tops
//! cabinets    cabinets and drawers, below and above
//! appliances  sink, stove, fridge, dishwasher, microwave, hood
//! shell       walls with openings, door, windows
//! furniture   tables, shelves, what stands and hangs at free walls
//! floor_plan  where furniture stands and where it must not
//! frame       a wall's coordinates, bodies made of parts
//! wall        what of a wall's length is taken; holes in it
//! draft       the layout in the making
//! ```
//!
//! This file is the order in which a kitchen is laid out: the runs, the door, what hangs above, then furniture on what
//! floor is left.

mod appliances;
mod cabinets;
mod draft;
pub mod floor_plan;
mod frame;
mod furniture;
mod plan;
mod run;
mod shell;
mod wall;

use super::kitchen_key::KitchenKey;
use super::room::{Fixture, Surface};
use super::{ithor, quota};
use draft::{Draft, Style};
pub use draft::{Seat, Worktop, WorktopKind};
use floor_plan::{FloorPlan, Rectangle, WORKING_DEPTH_M};
use frame::{Assembly, Frame, Span};
pub use plan::Plan;
use plan::{Order, RoomBrief, Shelves};
use proto::random::Random;
use rapier3d::math::Vec3;
use run::{CORNER_M, COUNTER_DEPTH_M, Run, Slot, Unit, divide};
use shell::{Drapery, ROOM_HEIGHT_M};
use wall::Wall;

/// Longest runs of counters, metres: a limit for the way between sink and fridge.
const MAIN_LONGEST_M: f32 = 4.7;
const SIDE_LONGEST_M: f32 = 3.2;
const OPPOSITE_LONGEST_M: f32 = 3.6;
/// Floor that a side run leaves free before the wall that faces the main one, metres.
const SIDE_END_M: f32 = 1.05;
/// A main run that would end this near to a wall goes up to it, metres.
const GAP_LEAST_M: f32 = 0.5;
const AISLE_M: f32 = 1.08;
/// Overhang of an island's or a peninsula's top over the stools' side, metres.
const OVERHANG_M: f32 = 0.26;
/// Share of islands and peninsulas with a raised bar at the back, and how far it is raised, metres.
const BAR_SHARE: f32 = 0.5;
const BAR_RISE_M: f32 = 0.16;
/// Where wall cabinets of a side run begin, before the base cabinets do: beside the main run's wall cabinets, metres.
const ABOVE_CORNER_M: f32 = -0.22;
/// Share of the kitchens with the microwave above the stove; in the others it stands on the counter.
const MICROWAVE_ABOVE_SHARE: f32 = 0.25;
/// Rooms smaller than this always have it there: their counters are needed, square metres.
const SMALL_ROOM_M2: f32 = 16.0;

/// A room with all that is fixed in it, before small things stand there.
#[derive(Debug, Clone)]
pub struct FittedRoom {
    pub plan: Plan,
    /// Fixed bodies: floor, four walls, ceiling, then furniture.
    pub fixtures: Vec<Fixture>,
    pub worktops: Vec<Worktop>,
    pub floor: Rectangle,
    pub seats: Vec<Seat>,
    pub chairs: u32,
    pub stools: u32,
    /// Middles of the large burners' tops.
    pub burners: Vec<Vec3>,
    /// Middle of the sink, at the counter's height.
    pub sink: Vec3,
    /// Free lengths of wall, where a bin can stand: two ends on the floor, and the unit vector into the room.
    pub free_walls: Vec<(Vec3, Vec3, Vec3)>,
    /// Floor before the door, where nothing at all stands.
    pub before_door: Rectangle,
    /// Floor that stays free of fixtures: before fronts and the door.
    pub kept_clear: Vec<Rectangle>,
}

impl FittedRoom {
    /// Lays a kitchen out. The error is what found no place.
    pub fn draw(kitchen: impl Into<KitchenKey>, random: &mut Random) -> Result<Self, &'static str> {
        let kitchen = kitchen.into();
        let brief = RoomBrief::of(kitchen);
        let walls = walls(&brief, random);
        let style = Style::draw(random);
        let (share, mean) = ithor::share_and_mean("Drawer");
        let few_more = random.below(5);
        let drawers = match quota::count(kitchen, "Drawer", share, mean) {
            0 => 0,
            count => count + few_more - 2,
        };
        let mut draft = Draft {
            random,
            style,
            walls,
            fixtures: Vec::new(),
            tops: Vec::new(),
            worktops: Vec::new(),
            seats: Vec::new(),
            burners: Vec::new(),
            sink: None,
            floor_plan: FloorPlan::default(),
            before_door: Rectangle { low: Vec3::ZERO, high: Vec3::ZERO },
            drawers,
            burner_count: quota::count(kitchen, "StoveBurner", 1.0, ithor::share_and_mean("StoveBurner").1),
        };
        draft.lay_out(kitchen, &brief)?;
        Ok(draft.finish(&brief))
    }
}

/// The four walls: the main one, the one at its beginning, the one at its end, the one that faces it. Which way the
/// room is turned and whether it is mirrored is drawn.
fn walls(brief: &RoomBrief, random: &mut Random) -> [Wall; 4] {
    let [x, z] = brief.size_m;
    let (length, depth) = if brief.main_along_x { (x, z) } else { (z, x) };
    let mut sign = || if random.uniform() < 0.5 { -1.0 } else { 1.0 };
    let (side, mirror) = (sign(), sign());
    let (axis_along, axis_out) = if brief.main_along_x { (Vec3::X, Vec3::Z) } else { (Vec3::Z, Vec3::X) };
    let (along, out) = (mirror * axis_along, -side * axis_out);
    let main = Frame { origin: -0.5 * (length * along + depth * out), along, out };
    let left = Frame { origin: main.origin, along: out, out: along };
    let right = Frame { origin: main.at(length, 0.0, 0.0), along: out, out: -along };
    let opposite = Frame { origin: main.at(0.0, 0.0, depth), along, out: -out };
    [Wall::new(main, length), Wall::new(left, depth), Wall::new(right, depth), Wall::new(opposite, length)]
}

/// A run at a wall: which wall, and how far along it the run's frame begins.
struct AtWall {
    run: Run,
    wall: usize,
    offset_m: f32,
}

impl Draft<'_> {
    fn lay_out(&mut self, kitchen: KitchenKey, brief: &RoomBrief) -> Result<(), &'static str> {
        let runs = self.runs(brief)?;
        self.before_door = self.doorway().ok_or("the door")?;
        self.windows(kitchen, &runs);
        self.above(kitchen, brief.shelves == Shelves::OnWall, &runs);
        for _ in 0..brief.tables {
            // A second table is welcome; without the first one chairs have no place.
            if self.dining_table().is_none() && self.seats.iter().all(|seat| seat.at_counter) {
                return Err("the dining table");
            }
        }
        if brief.shelves == Shelves::Unit {
            self.shelving_unit(3).ok_or("the shelving unit")?;
        }
        if quota::among(kitchen, "SideTable", ithor::share_and_mean("SideTable").0) {
            self.side_table().ok_or("the side table")?;
        }
        if quota::among(kitchen, "Safe", ithor::share_and_mean("Safe").0) {
            self.safe().ok_or("the safe")?;
        }
        if quota::among(kitchen, "Mirror", ithor::share_and_mean("Mirror").0) {
            self.mirror().ok_or("the mirror")?;
        }
        Ok(())
    }

    /// Builds all runs, island and peninsula included; returns those at walls.
    fn runs(&mut self, brief: &RoomBrief) -> Result<Vec<AtWall>, &'static str> {
        let (length, depth) = (self.walls[0].length_m, self.walls[1].length_m);
        let side_m = (depth - COUNTER_DEPTH_M - SIDE_END_M).min(SIDE_LONGEST_M);
        let order = Order::of(brief.plan, side_m);
        let main_m = match brief.plan {
            Plan::You => length,
            Plan::Peninsula => (length - 1.35).min(MAIN_LONGEST_M),
            _ if length - MAIN_LONGEST_M < GAP_LEAST_M => length,
            _ => MAIN_LONGEST_M,
        };
        // What a kitchen needs goes before how its corners lie: a side wall begins behind the main run.
        for wall in [1, 2] {
            self.walls[wall].taken.push([0.0, COUNTER_DEPTH_M + 0.06]);
        }
        let mut runs = Vec::new();
        let main = self.at_wall_run(0, 0.0, &order.main, main_m).ok_or("the main run")?;
        let main_tops = self.run(&main.run, None);
        runs.push(main);
        for (wall, slots, joins) in [(1, &order.left, main_tops[0]), (2, &order.right, main_tops[1])] {
            if slots.is_empty() {
                continue;
            }
            let side = self.at_wall_run(wall, COUNTER_DEPTH_M, slots, side_m).ok_or("a side run")?;
            self.run(&side.run, joins);
            runs.push(side);
        }
        if !order.opposite.is_empty() {
            let longest = if length - OPPOSITE_LONGEST_M < GAP_LEAST_M { length } else { OPPOSITE_LONGEST_M };
            let opposite = self.at_wall_run(3, 0.0, &order.opposite, longest).ok_or("the opposite run")?;
            self.run(&opposite.run, None);
            runs.push(opposite);
            for wall in [1, 2] {
                self.walls[wall].taken.push([depth - COUNTER_DEPTH_M - 0.15, depth]);
            }
        }
        match brief.plan {
            Plan::Island => self.island(main_m, length),
            Plan::Peninsula => self.peninsula(main_m, depth, main_tops[1]),
            _ => {}
        }
        Ok(runs)
    }

    /// Divides a run at a wall and notes the floor that it takes.
    fn at_wall_run(&mut self, wall: usize, offset_m: f32, slots: &[Slot], length_m: f32) -> Option<AtWall> {
        let units = divide(slots, length_m, self.random)?;
        let frame = self.walls[wall].frame.shifted(offset_m, 0.0);
        self.walls[wall].taken.push([0.0, offset_m + length_m + 0.03]);
        let headroom_m = self.style.wall_cabinet_m[0];
        let run = Run { frame, units, overhang_m: 0.0, headroom_m, kind: WorktopKind::Counter };
        self.claim_floor(&run);
        Some(AtWall { run, wall, offset_m })
    }

    /// Notes the floor under a run as occupied, and that before its fronts as to be kept clear.
    fn claim_floor(&mut self, run: &Run) {
        let deepest = COUNTER_DEPTH_M + 0.02;
        let under = run.frame.block(run.along(), [0.0, 0.0], [-run.overhang_m, deepest]);
        self.floor_plan.occupied.push(Rectangle::below(under));
        let fronts: Vec<Span> = run
            .units
            .iter()
            .filter(|placed| !matches!(placed.unit, Unit::Corner | Unit::Filler))
            .map(|placed| placed.along)
            .collect();
        if let (Some(first), Some(last)) = (fronts.first(), fronts.last()) {
            let out = [COUNTER_DEPTH_M + 0.12, COUNTER_DEPTH_M + WORKING_DEPTH_M];
            // A door's casing in the wall at the run's end is not in the way.
            let before = run.frame.block([first[0] + 0.05, last[1] - 0.05], [0.0, 0.0], out);
            self.floor_plan.kept_clear.push(Rectangle::below(before));
        }
    }

    /// A block of counter before the main run, stools at its back.
    fn island(&mut self, main_m: f32, length: f32) {
        let long = (main_m.min(length) - 2.2).clamp(1.3, 2.3) * self.random.range(0.85, 1.0);
        let from = 1.0 + self.random.uniform() * (length - 2.0 - long).max(0.0).min(main_m - 1.0 - long);
        let main = self.walls[0].frame;
        let back = COUNTER_DEPTH_M + AISLE_M + COUNTER_DEPTH_M;
        let frame = Frame { origin: main.at(from, 0.0, back), along: main.along, out: -main.out };
        self.free_standing(frame, long, 0.0, None);
    }

    /// A counter that leads into the room from the main run's end, stools behind it.
    fn peninsula(&mut self, main_m: f32, depth: f32, joins: Option<usize>) {
        let long = (depth - COUNTER_DEPTH_M - SIDE_END_M).min(2.0) * self.random.range(0.85, 1.0);
        let main = self.walls[0].frame;
        let frame = Frame { origin: main.at(main_m, 0.0, COUNTER_DEPTH_M), along: main.out, out: -main.along };
        self.free_standing(frame, long, CORNER_M - COUNTER_DEPTH_M, joins);
    }

    /// Counter without a wall behind it: cabinets in front, a panel and seats at the back.
    fn free_standing(&mut self, frame: Frame, long: f32, filler: f32, joins: Option<usize>) {
        const STOOL_WIDTH_M: f32 = 0.58;
        let mut units = Vec::new();
        if filler > 0.0 {
            units.push(run::Placed { unit: Unit::Filler, along: [0.0, filler] });
        }
        units.push(run::Placed { unit: Unit::Cabinets, along: [filler, long] });
        let mut run =
            Run { frame, units, overhang_m: OVERHANG_M, headroom_m: ROOM_HEIGHT_M, kind: WorktopKind::Island };
        self.claim_floor(&run);
        if self.random.uniform() < BAR_SHARE {
            run.overhang_m = 0.0;
            self.bar(frame, [filler, long]);
        }
        self.run(&run, joins);
        let count = libm::floorf((long - filler) / STOOL_WIDTH_M) as u32;
        for index in 0..count {
            let along = filler + (index as f32 + 0.5) * (long - filler) / count as f32;
            // The run's own floor reaches to the overhang's edge; the stool's begins there.
            self.seat(frame.at(along, 0.0, -OVERHANG_M), frame.out, true);
        }
    }

    /// A raised ledge on a panel along the back of a free-standing counter, to sit at.
    fn bar(&mut self, frame: Frame, along: Span) {
        const PANEL_M: f32 = 0.04;
        let counter = self.style.counter_height_m;
        let up = [counter + BAR_RISE_M - self.style.slab_m, counter + BAR_RISE_M];
        let out = [-OVERHANG_M, 0.08];
        self.fix("Filler", Assembly::new(frame).slab(along, [0.0, up[0]], [-PANEL_M, 0.0]));
        self.tops.push(Assembly::new(frame).slab(along, up, out));
        let (low, high) = frame.block(along, [up[1], ROOM_HEIGHT_M], out);
        let surface = Surface { low, high };
        self.worktops.push(Worktop { surface, kind: WorktopKind::Island, back: None });
    }

    /// The window over the sink, and another one where a wall is free.
    fn windows(&mut self, kitchen: KitchenKey, runs: &[AtWall]) {
        let (share, mean) = ithor::share_and_mean("Window");
        let rank = quota::rank(kitchen, "Window");
        let windows = quota::count_of_rank(rank, share, mean);
        let blinds = quota::holders(ithor::share_and_mean("Blinds").0);
        let curtains = quota::holders(ithor::share_and_mean("Curtains").0);
        // Counted from the last that has a window, so that one and two windows occur with either.
        let from_last = quota::holders(share).saturating_sub(rank + 1);
        let drapery = match from_last {
            _ if from_last < blinds => Drapery::Blinds,
            _ if from_last < blinds + curtains => Drapery::Curtains,
            _ => Drapery::None,
        };
        if windows == 0 {
            return;
        }
        if let Some((run, sink)) = runs.iter().find_map(|at| at.run.of(Unit::Sink).next().map(|sink| (at, sink))) {
            let along = sink.map(|along| along + run.offset_m);
            let wide = self.random.range(0.05, 0.25);
            let length = self.walls[run.wall].length_m;
            self.window(run.wall, [(along[0] - wide).max(0.15), (along[1] + wide).min(length - 0.15)], drapery);
        }
        for _ in 1..windows {
            let wide = self.random.range(0.9, 1.3);
            let spans: Vec<(usize, Span)> = (0..4)
                .flat_map(|wall| self.walls[wall].free().into_iter().map(move |span| (wall, span)))
                .filter(|(_, span)| span[1] - span[0] >= wide + 0.4)
                .collect();
            if spans.is_empty() {
                return;
            }
            let (wall, span) = spans[self.random.below(spans.len() as u32) as usize];
            let from = span[0] + 0.2 + self.random.uniform() * (span[1] - span[0] - wide - 0.4);
            self.window(wall, [from, from + wide], Drapery::None);
        }
    }

    fn above(&mut self, kitchen: KitchenKey, mut wall_shelves: bool, runs: &[AtWall]) {
        let room = self.room().high - self.room().low;
        let small = room.x * room.z < SMALL_ROOM_M2;
        let microwave_above = small || quota::among(kitchen, "microwave above the stove", MICROWAVE_ABOVE_SHARE);
        for (index, at) in runs.iter().enumerate() {
            let run = &at.run;
            if index > 1 && run.of(Unit::Stove).next().is_none() {
                // Of three runs one has free wall above.
                continue;
            }
            let begin = if at.offset_m > 0.0 { ABOVE_CORNER_M } else { 0.0 };
            let mut blocked: Vec<Span> = run.of(Unit::Fridge).collect();
            for stove in run.of(Unit::Stove) {
                self.above_stove(run.frame, stove, microwave_above);
                blocked.push(stove);
            }
            let windows = self.walls[at.wall].openings.iter().filter(|opening| opening.up[0] > 0.0);
            blocked.extend(
                windows.map(|window| [window.along[0] - at.offset_m - 0.12, window.along[1] - at.offset_m + 0.12]),
            );
            let mut line = Wall::new(run.frame, run.along()[1] - begin);
            line.taken = blocked.iter().map(|span| [span[0] - begin, span[1] - begin]).collect();
            for free in line.free() {
                let along = [free[0] + begin, free[1] + begin];
                if wall_shelves && (0.6..2.2).contains(&(along[1] - along[0])) {
                    wall_shelves = false;
                    self.wall_shelves(run.frame, along, 3);
                } else {
                    self.cabinets_above(run.frame, along);
                }
            }
        }
        if !microwave_above {
            self.microwave_somewhere(runs);
        }
    }

    /// The microwave on the longest piece of counter between other units.
    fn microwave_somewhere(&mut self, runs: &[AtWall]) {
        let width = appliances::MICROWAVE_WIDTH_M;
        let pieces = runs.iter().flat_map(|at| at.run.of(Unit::Cabinets).map(|along| (at.run.frame, along)));
        let longest = pieces.max_by(|(_, a), (_, b)| (a[1] - a[0]).total_cmp(&(b[1] - b[0])));
        if let Some((frame, along)) = longest {
            let slack = (along[1] - along[0] - width - 0.04).max(0.0);
            let share = [0.0, 1.0][self.random.below(2) as usize];
            let from = along[0] + 0.02 + share * slack;
            self.microwave_on_counter(frame, from);
        }
    }

    /// The room, with the shell before all else.
    fn finish(mut self, brief: &RoomBrief) -> FittedRoom {
        for top in std::mem::take(&mut self.tops) {
            self.fix("CounterTop", top);
        }
        let floor = self.room();
        let mut fixtures = shell::shell(&self.walls);
        fixtures.append(&mut self.fixtures);
        let free_walls = self
            .walls
            .iter()
            .flat_map(|wall| {
                wall.free()
                    .into_iter()
                    .map(|span| (wall.frame.at(span[0], 0.0, 0.0), wall.frame.at(span[1], 0.0, 0.0), wall.frame.out))
            })
            .collect();
        FittedRoom {
            plan: brief.plan,
            fixtures,
            worktops: self.worktops,
            floor,
            seats: self.seats,
            chairs: brief.chairs,
            stools: brief.stools,
            burners: self.burners,
            sink: self.sink.unwrap_or(Vec3::ZERO),
            free_walls,
            before_door: self.before_door,
            kept_clear: self.floor_plan.kept_clear,
        }
    }
}
