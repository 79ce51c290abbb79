//! Plans: how large a kitchen is, which walls carry runs of counters, and in which order units stand in them.

use super::run::{Slot, Unit};
use crate::kitchen::kitchen_key::KitchenKey;
use crate::kitchen::{ithor, quota};
use proto::kitchen::KitchenId;
use std::collections::BTreeMap;
use std::sync::LazyLock;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Plan {
    OneWall,
    /// Two runs that meet in a corner.
    Ell,
    /// Three runs about two corners.
    You,
    /// Two runs that face each other.
    Galley,
    /// One run, and a block of counter that stands free before it.
    Island,
    /// One run, and a counter that leads from its end into the room.
    Peninsula,
}

#[derive(Debug, Clone, Copy)]
pub(super) struct RoomBrief {
    pub plan: Plan,
    /// Inner size of the room along the world's x and z, metres.
    pub size_m: [f32; 2],
    pub main_along_x: bool,
    pub tables: u32,
    pub chairs: u32,
    /// Stools at the island, the peninsula, or a table.
    pub stools: u32,
    pub shelves: Shelves,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Shelves {
    None,
    /// Boards on the wall over a counter.
    OnWall,
    /// A unit on the floor.
    Unit,
}

/// A room is larger than the extent of its objects' centres: those at a wall have theirs this far from it, both
/// sides together, metres.
const CENTRES_TO_WALLS_M: f32 = 0.4;

impl Plan {
    const ALL: [Self; 6] = [Self::OneWall, Self::Ell, Self::You, Self::Galley, Self::Island, Self::Peninsula];

    pub fn name(self) -> &'static str {
        match self {
            Self::OneWall => "one wall",
            Self::Ell => "L",
            Self::You => "U",
            Self::Galley => "galley",
            Self::Island => "island",
            Self::Peninsula => "peninsula",
        }
    }

    /// Whether a room has space for it whose main wall is `length` and whose other walls are `depth` long, metres.
    fn fits(self, length: f32, depth: f32) -> bool {
        match self {
            Self::OneWall => (3.9..=6.0).contains(&length) && depth <= 5.2,
            // Two runs have too little counter in a small room.
            Self::Ell => length >= 3.1 && depth >= 2.9 && length * depth >= 18.0,
            Self::You => (2.9..=4.6).contains(&length) && depth >= 3.2,
            Self::Galley => length >= 3.4 && (2.4..=3.7).contains(&depth),
            Self::Island => length >= 4.2 && depth >= 4.1,
            Self::Peninsula => length >= 5.2 && depth >= 3.4,
        }
    }

    /// How readily it is chosen where it fits: what few rooms can have is chosen more readily.
    fn weight(self) -> f32 {
        match self {
            Self::Ell | Self::You => 1.0,
            Self::Island | Self::Peninsula | Self::Galley => 2.0,
            Self::OneWall => 6.0,
        }
    }
}

/// Procedural rooms with a table or stools are larger, so more of their draws are accepted. To find as many as iTHOR has,
/// fewer are planned: this share of iTHOR's. Chosen on kitchens 1000 to 1199, tested on others.
const DRAWN: [(&str, f32); 2] = [("DiningTable", 0.8), ("Stool", 0.85)];

impl RoomBrief {
    pub fn of(kitchen: KitchenKey) -> Self {
        static BUILT_IN: LazyLock<BTreeMap<KitchenId, RoomBrief>> =
            LazyLock::new(|| all(&KitchenId::all().map(KitchenKey::from).collect::<Vec<_>>()));
        if kitchen.id().is_built_in() { BUILT_IN[&kitchen.id()] } else { all(&kitchen.set())[&kitchen.id()] }
    }
}

/// The briefs of all kitchens of a set, which share out tables and seats among them.
fn all(set: &[KitchenKey]) -> BTreeMap<KitchenId, RoomBrief> {
    let is_procedural = set.iter().any(|kitchen_key| kitchen_key.id().is_procedural());
    let numbers = |category, rank| {
        let (share, mean) = ithor::share_and_mean(category);
        let drawn = DRAWN.into_iter().find(|&(name, _)| is_procedural && name == category);
        let share = share * drawn.map_or(1.0, |(_, drawn)| drawn);
        quota::count_of_rank(rank, share, mean)
    };
    // Tables stand in the larger rooms.
    let table_ranks = ranks(set, |id| {
        let [x, z] = size_m(id);
        x * z * (0.8 + 0.4 * quota::quantile(id, "DiningTable"))
    });
    let has_table = |id: KitchenKey| numbers("DiningTable", table_ranks[&id.id()]) > 0;
    let plans: BTreeMap<KitchenId, (Plan, bool)> =
        set.iter().map(|&id| (id.id(), plan(id, size_m(id), has_table(id)))).collect();
    // Stools stand at islands and peninsulas first, then at tables.
    let stool_ranks = ranks(set, |id| {
        let preference = match plans[&id.id()].0 {
            Plan::Island | Plan::Peninsula => 2.0,
            _ => f32::from(u8::from(has_table(id))),
        };
        preference + 0.5 * quota::quantile(id, "Stool")
    });
    // A galley has no floor for a shelving unit.
    let shelf_ranks =
        ranks(set, |id| f32::from(u8::from(plans[&id.id()].0 != Plan::Galley)) + 0.5 * quota::quantile(id, "Shelf"));
    let shelves = |rank| match rank {
        _ if numbers("ShelvingUnit", rank) > 0 => Shelves::Unit,
        _ if numbers("Shelf", rank) > 0 => Shelves::OnWall,
        _ => Shelves::None,
    };
    set.iter()
        .map(|&kitchen_key| {
            let id = kitchen_key.id();
            let (plan, main_along_x) = plans[&id];
            let brief = RoomBrief {
                plan,
                size_m: size_m(kitchen_key),
                main_along_x,
                tables: numbers("DiningTable", table_ranks[&id]),
                chairs: numbers("Chair", table_ranks[&id]),
                stools: numbers("Stool", stool_ranks[&id]),
                shelves: shelves(shelf_ranks[&id]),
            };
            (id, brief)
        })
        .collect()
}

/// Each kitchen's place, from 0, when all are ordered by a score, highest first.
fn ranks(set: &[KitchenKey], score: impl Fn(KitchenKey) -> f32) -> BTreeMap<KitchenId, usize> {
    let mut order: Vec<(f32, KitchenId)> = set.iter().map(|&id| (score(id), id.id())).collect();
    order.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    order.into_iter().enumerate().map(|(rank, (_, id))| (id, rank)).collect()
}

/// Inner size along x and z, metres: iTHOR's distribution, through least, median and largest.
fn size_m(kitchen: KitchenKey) -> [f32; 2] {
    let size = |question, [least, median, largest]: [f32; 3]| {
        // Nine tenths of the rooms lie in the lower half of what is above the median.
        let knots = [(0.0, least), (0.5, median), (0.9, 0.5 * (median + largest)), (1.0, largest)];
        interpolate(&knots, quota::measure(kitchen, question)) + CENTRES_TO_WALLS_M
    };
    [size("width", ithor::EXTENT_X_M), size("depth", ithor::EXTENT_Z_M)]
}

/// Piecewise linear through knots of ascending abscissa.
fn interpolate(knots: &[(f32, f32)], at: f32) -> f32 {
    let upper = knots.iter().position(|&(x, _)| x >= at).unwrap_or(knots.len() - 1).max(1);
    let ((x0, y0), (x1, y1)) = (knots[upper - 1], knots[upper]);
    y0 + (y1 - y0) * ((at - x0) / (x1 - x0)).clamp(0.0, 1.0)
}

/// A plan that fits, and whether its main wall lies along x.
fn plan(kitchen: KitchenKey, size_m: [f32; 2], has_table: bool) -> (Plan, bool) {
    let [x, z] = size_m;
    let options: Vec<(Plan, bool)> = Plan::ALL
        .into_iter()
        .flat_map(|plan| [(plan, true), (plan, false)])
        .filter(|&(plan, along_x)| if along_x { plan.fits(x, z) } else { plan.fits(z, x) })
        // One run alone has too little room for all that a kitchen holds.
        .filter(|&(plan, _)| plan != Plan::OneWall || has_table)
        .collect();
    let total: f32 = options.iter().map(|(plan, _)| plan.weight()).sum();
    let mut at = quota::quantile(kitchen, "plan") * total;
    for &option in &options {
        at -= option.0.weight();
        if at < 0.0 {
            return option;
        }
    }
    // Any room but a very narrow one has space for an L.
    options.last().copied().unwrap_or((Plan::Ell, x >= z))
}

pub(super) struct Order {
    /// Along the main wall, from its beginning.
    pub main: Vec<Slot>,
    /// Along the wall that begins where the main wall begins, from the corner.
    pub left: Vec<Slot>,
    /// Along the wall that begins where the main wall ends, from the corner.
    pub right: Vec<Slot>,
    /// Along the wall that faces the main one.
    pub opposite: Vec<Slot>,
}

impl Order {
    /// The order for a plan; `side_m` is the length that a run beside the main one can have.
    pub fn of(plan: Plan, side_m: f32) -> Self {
        use Unit::{Cabinets, Corner, Dishwasher, Filler, Fridge, Sink, Stove};
        let cabinets = |least_m| Slot { unit: Cabinets, least_m };
        let one = |unit: Unit| Slot { unit, least_m: unit.width_m() };
        let none = Vec::new;
        match plan {
            Plan::OneWall | Plan::Island => Self {
                main: vec![
                    one(Fridge),
                    cabinets(0.4),
                    one(Sink),
                    one(Dishwasher),
                    cabinets(0.5),
                    one(Stove),
                    cabinets(0.4),
                ],
                left: none(),
                right: none(),
                opposite: none(),
            },
            Plan::Ell if side_m >= 2.25 => Self {
                main: vec![one(Corner), cabinets(0.3), one(Sink), one(Dishwasher), cabinets(0.5)],
                left: vec![one(Filler), cabinets(0.4), one(Stove), cabinets(0.35), one(Fridge)],
                right: none(),
                opposite: none(),
            },
            Plan::Ell => Self {
                main: vec![one(Corner), cabinets(0.3), one(Sink), cabinets(0.4), one(Stove), cabinets(0.3)],
                left: vec![one(Filler), cabinets(0.35), one(Fridge)],
                right: none(),
                opposite: none(),
            },
            Plan::You => Self {
                main: vec![one(Corner), cabinets(0.2), one(Sink), one(Dishwasher), cabinets(0.2), one(Corner)],
                left: vec![one(Filler), cabinets(0.4), one(Stove), cabinets(0.35)],
                right: vec![one(Filler), cabinets(0.4), one(Fridge)],
                opposite: none(),
            },
            Plan::Galley => Self {
                main: vec![cabinets(0.4), one(Sink), one(Dishwasher), cabinets(0.4)],
                left: none(),
                right: none(),
                opposite: vec![one(Fridge), cabinets(0.4), one(Stove), cabinets(0.4)],
            },
            Plan::Peninsula => Self {
                main: vec![
                    one(Fridge),
                    cabinets(0.35),
                    one(Stove),
                    cabinets(0.5),
                    one(Sink),
                    one(Dishwasher),
                    cabinets(0.2),
                    one(Corner),
                ],
                left: none(),
                right: none(),
                opposite: none(),
            },
        }
    }
}
