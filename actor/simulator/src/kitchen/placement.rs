//! Positions of movable things: drawn at random, without overlap, before physics settles them.
//!
//! Things are set down one after the other, large ones first. For each a distance to its nearest neighbour is drawn,
//! and of a number of free places that one is taken which comes nearest to it: this is what makes groups, gaps and
//! loners in the proportions that kitchens have. How places are drawn is what makes the clutter plausible: backs of
//! counters, sponges at the sink, spatulas at the stove.

use super::catalogue::{CATEGORIES, Category, Pattern, Place, Presence, pattern};
use super::density;
use super::kitchen_key::KitchenKey;
use super::layout::floor_plan::Rectangle;
use super::layout::{FittedRoom, Seat, Worktop, WorktopKind};
use super::quota;
use super::room::Thing;
use crate::physics::fixed_scene::FixedScene;
use crate::physics::geometry::{Solid, rotation_y};
use proto::random::Random;
use rapier3d::geometry::Aabb;
use rapier3d::math::{Pose3, Vec3};
use rapier3d::parry::bounding_volume::BoundingVolume;
use std::f32::consts::PI;

/// Things are set down from this height, metres.
pub const DROP_M: f32 = 0.001;
const FLOOR_TRIES: u32 = 200;

/// A surface and the fixed things that rise from it or hang over it.
struct Site {
    worktop: Worktop,
    obstacles: Vec<Aabb>,
}

struct Furnishing<'a> {
    layout: &'a FittedRoom,
    scene: &'a FixedScene,
    sites: Vec<Site>,
    things: Vec<Thing>,
    /// Bounding boxes of what is there.
    taken: Vec<Aabb>,
    /// Centres of the small things.
    small: Vec<Vec3>,
    /// How much wider than usual things stand.
    spread: f32,
    free_burners: Vec<Vec3>,
    free_seats: Vec<Seat>,
}

/// Draws which things a kitchen holds and where they stand. The error is the category that found no room.
pub fn place(
    kitchen: KitchenKey,
    layout: &FittedRoom,
    scene: &FixedScene,
    random: &mut Random,
) -> Result<Vec<Thing>, &'static str> {
    let mut furnishing = Furnishing::new(layout, scene);
    let extras = extras(random);
    for (index, category) in CATEGORIES.iter().enumerate() {
        let wanted = match (category.place, category.presence) {
            (Place::Seat, _) if category.name == "Stool" => layout.stools,
            (Place::Seat, _) => layout.chairs,
            (_, Presence::Every) => 1,
            (_, Presence::Share { share, per_kitchen }) => quota::count(kitchen, category.name, share, per_kitchen),
            (_, Presence::Extra) => u32::from(extras.contains(&index)),
        };
        for _ in 0..wanted {
            // What is there for variety only may be left out.
            if furnishing.add(pattern(index).ok_or(category.name)?, random).is_none()
                && category.presence != Presence::Extra
            {
                return Err(category.name);
            }
        }
    }
    Ok(furnishing.things)
}

fn extras(random: &mut Random) -> Vec<usize> {
    let all: Vec<usize> =
        (0..CATEGORIES.len()).filter(|&index| CATEGORIES[index].presence == Presence::Extra).collect();
    let count = random.below(density::EXTRAS_MOST + 1).min(all.len() as u32);
    (0..count).map(|_| all[random.below(all.len() as u32) as usize]).collect()
}

impl<'a> Furnishing<'a> {
    fn new(layout: &'a FittedRoom, scene: &'a FixedScene) -> Self {
        let sites = layout
            .worktops
            .iter()
            .map(|&worktop| {
                let volume = Aabb::new(worktop.surface.low, worktop.surface.high);
                let obstacles = scene.aabbs().iter().filter(|aabb| aabb.intersects(&volume)).copied().collect();
                Site { worktop, obstacles }
            })
            .collect();
        let area_m2: f32 = layout.worktops.iter().map(|worktop| worktop.surface.area_m2()).sum();
        Self {
            layout,
            scene,
            sites,
            things: Vec::new(),
            taken: Vec::new(),
            small: Vec::new(),
            spread: f32::sqrt(area_m2 / density::USUAL_AREA_M2).clamp(density::SPREAD[0], density::SPREAD[1]),
            free_burners: layout.burners.clone(),
            free_seats: layout.seats.clone(),
        }
    }

    fn add(&mut self, pattern: &Pattern, random: &mut Random) -> Option<()> {
        let Pattern { category, solid } = pattern;
        let pose = match category.place {
            Place::Seat => self.seat(category.name == "Stool", solid, random),
            Place::Floor => self.beside_wall(solid, random),
            _ => {
                let burner =
                    matches!(category.name, "Pot" | "Pan" | "Kettle") && random.uniform() < density::ON_BURNER_SHARE;
                let on_burner = if burner { self.on_burner(solid, random) } else { None };
                let pose = on_burner.or_else(|| self.on_surface(category, solid, random));
                self.small.extend(pose.map(|pose| pose.translation));
                pose
            }
        }?;
        self.taken.push(solid.aabb(&pose));
        self.things.push(Thing::of(pattern, pose));
        Some(())
    }

    /// Of some free places on surfaces, the one whose distance to the nearest neighbour is most like one drawn.
    fn on_surface(&self, category: &Category, solid: &Solid, random: &mut Random) -> Option<Pose3> {
        let half_height = half_height(solid);
        let preference = density::preference(category.place);
        let weight = |site: &Site| site.worktop.surface.area_m2() * preference[site.worktop.kind as usize];
        let total: f32 = self.sites.iter().map(weight).sum();
        let wanted_m = wanted_distance(random) * self.spread;
        let beside = self.haunt(category);
        let mut best: Option<(f32, Pose3)> = None;
        let mut found = 0;
        for _ in 0..density::TRIES {
            if found == density::CANDIDATES {
                break;
            }
            let site = pick(&self.sites, weight, total, random)?;
            let point = draw_point(&site.worktop, random);
            if let Some(haunt) = beside {
                let away = (point - haunt).with_y(0.0).length() / density::BESIDE_M;
                if random.uniform() * (1.0 + away * away) > 1.0 {
                    continue;
                }
            }
            let position = point + Vec3::new(0.0, half_height + DROP_M, 0.0);
            let pose = Pose3::from_parts(position, rotation_y(random.range(-PI, PI)));
            let whole = solid.aabb(&pose);
            let inside = whole.loosened(density::EDGE_M);
            let surface = &site.worktop.surface;
            let free = surface.carries(&Aabb::new(inside.mins.with_y(whole.mins.y), inside.maxs.with_y(whole.maxs.y)))
                && !parts_meet(solid, &pose, &site.obstacles)
                && !self.meets_thing(solid, &pose);
            if !free {
                continue;
            }
            found += 1;
            let miss_m = (self.nearest_m(position).unwrap_or(wanted_m) - wanted_m).abs();
            if best.is_none_or(|(least, _)| miss_m < least) {
                best = Some((miss_m, pose));
            }
        }
        best.map(|(_, pose)| pose)
    }

    fn nearest_m(&self, position: Vec3) -> Option<f32> {
        self.small.iter().map(|other| (*other - position).length()).min_by(f32::total_cmp)
    }

    /// What a category is used at.
    fn haunt(&self, category: &Category) -> Option<Vec3> {
        match (category.name, category.place) {
            ("DishSponge" | "SoapBottle", _) | (_, Place::Sink) => Some(self.layout.sink),
            ("Spatula" | "Ladle", _) | (_, Place::Stove) => self.layout.burners.first().copied(),
            _ => None,
        }
    }

    fn on_burner(&mut self, solid: &Solid, random: &mut Random) -> Option<Pose3> {
        if self.free_burners.is_empty() {
            return None;
        }
        let burner = self.free_burners.remove(random.below(self.free_burners.len() as u32) as usize);
        // A pan's middle is not its bounding box's: the handle counts in that. Its round part shall cover the burner.
        let round = solid.parts.first()?.1.translation.with_y(0.0);
        let half_height = half_height(solid);
        (0..FLOOR_TRIES).find_map(|_| {
            let turn = rotation_y(random.range(-PI, PI));
            let position = burner - turn * round + Vec3::new(0.0, half_height + DROP_M, 0.0);
            let pose = Pose3::from_parts(position, turn);
            self.is_free(solid, &pose).then_some(pose)
        })
    }

    /// At a table, facing it; stools at counters first. By a wall if there is no such place.
    fn seat(&mut self, stool: bool, solid: &Solid, random: &mut Random) -> Option<Pose3> {
        let counters = stool && self.free_seats.iter().any(|seat| seat.at_counter);
        let half_height = half_height(solid);
        for _ in 0..FLOOR_TRIES {
            let seats: Vec<usize> =
                (0..self.free_seats.len()).filter(|&seat| self.free_seats[seat].at_counter == counters).collect();
            if seats.is_empty() {
                break;
            }
            let chosen = seats[random.below(seats.len() as u32) as usize];
            let Seat { edge, facing, .. } = self.free_seats[chosen];
            let out = random.range(density::CHAIR_OUT_M[0], density::CHAIR_OUT_M[1]);
            let yaw = libm::atan2f(facing.x, facing.z) + random.range(-1.0, 1.0) * density::CHAIR_TURN_RAD;
            let position = edge - out * facing + Vec3::new(0.0, half_height + DROP_M, 0.0);
            let pose = Pose3::from_parts(position, rotation_y(yaw));
            if self.is_free(solid, &pose) {
                self.free_seats.remove(chosen);
                return Some(pose);
            }
        }
        if stool { self.beside_wall(solid, random) } else { None }
    }

    /// On the floor at a free length of wall, out of the way of doors and fronts.
    fn beside_wall(&self, solid: &Solid, random: &mut Random) -> Option<Pose3> {
        let half = solid.aabb(&Pose3::identity()).half_extents();
        let out = half.x.max(half.z) + density::BIN_OUT_M;
        (0..FLOOR_TRIES).find_map(|attempt| {
            let (from, to, into) = self.layout.free_walls[random.below(self.layout.free_walls.len() as u32) as usize];
            let length = (to - from).length();
            if length < 2.0 * out {
                return None;
            }
            let share = [out, random.range(out, length - out), length - out][random.below(3) as usize] / length;
            let position = from + (to - from) * share + into * out + Vec3::new(0.0, half.y + DROP_M, 0.0);
            let pose = Pose3::from_parts(position, rotation_y(random.range(-PI, PI)));
            let aabb = solid.aabb(&pose);
            let below = Rectangle::below((aabb.mins, aabb.maxs));
            // In a small kitchen the bin has to be moved before a drawer opens; never before one leaves.
            let fronts: &[Rectangle] = if attempt < FLOOR_TRIES / 2 { &self.layout.kept_clear } else { &[] };
            let in_the_way = below.overlaps(&self.layout.before_door) || fronts.iter().any(|it| it.overlaps(&below));
            (!in_the_way && self.is_free(solid, &pose)).then_some(pose)
        })
    }

    fn is_free(&self, solid: &Solid, pose: &Pose3) -> bool {
        !parts_meet(solid, pose, self.scene.aabbs()) && !self.meets_thing(solid, pose)
    }

    /// Whether a thing that is already there would be nearer than the gap.
    fn meets_thing(&self, solid: &Solid, pose: &Pose3) -> bool {
        let around = solid.aabb(pose).loosened(density::GAP_M);
        self.taken.iter().zip(&self.things).any(|(aabb, thing)| {
            aabb.intersects(&around) && solid.nearer_than(pose, &thing.solid, &thing.pose, density::GAP_M)
        })
    }
}

fn half_height(solid: &Solid) -> f32 {
    0.5 * solid.aabb(&Pose3::identity()).extents().y
}

fn wanted_distance(random: &mut Random) -> f32 {
    let steps = (density::COMPANY_M.len() - 1) as f32;
    let at = random.uniform() * steps;
    let index = (at as usize).min(density::COMPANY_M.len() - 2);
    let (low, high) = (density::COMPANY_M[index], density::COMPANY_M[index + 1]);
    low + (high - low) * (at - index as f32)
}

/// Whether some part's bounding box meets something fixed.
fn parts_meet(solid: &Solid, pose: &Pose3, obstacles: &[Aabb]) -> bool {
    // Less than the height from which things are set down, so that what they stand on does not count.
    const MARGIN_M: f32 = 0.5 * DROP_M;
    solid.parts.iter().any(|(shape, body_from_part)| {
        let aabb = shape.compute_aabb(&(*pose * *body_from_part)).loosened(MARGIN_M);
        obstacles.iter().any(|other| other.intersects(&aabb))
    })
}

/// A point on a worktop: anywhere along, rather at the back.
fn draw_point(worktop: &Worktop, random: &mut Random) -> Vec3 {
    let (low, high) = (worktop.surface.low, worktop.surface.high);
    let (x, z) = (random.uniform(), random.uniform());
    let backwards = |share: f32, back: f32| match back {
        // The back is where the coordinate is small, or where it is large.
        back if back < 0.0 => libm::powf(share, density::BACKWARDS),
        back if back > 0.0 => 1.0 - libm::powf(share, density::BACKWARDS),
        _ => share,
    };
    let towards = if worktop.kind == WorktopKind::Counter { worktop.back } else { None }.unwrap_or(Vec3::ZERO);
    let (x, z) = (backwards(x, towards.x), backwards(z, towards.z));
    Vec3::new(low.x + x * (high.x - low.x), low.y, low.z + z * (high.z - low.z))
}

/// A site, with probability by weight.
fn pick<'s>(sites: &'s [Site], weight: impl Fn(&Site) -> f32, total: f32, random: &mut Random) -> Option<&'s Site> {
    let mut at = random.uniform() * total;
    for site in sites {
        at -= weight(site);
        if at < 0.0 {
            return Some(site);
        }
    }
    sites.last()
}
