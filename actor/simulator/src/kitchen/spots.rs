//! Where an episode can begin and end: free floor for the robot, free places for the target.

use super::floor::{CELL_M, CLEARANCE_M, Floor};
use super::placement::DROP_M;
use super::reach::Reach;
use super::room::Surface;
use crate::physics::fixed_scene::FixedScene;
use crate::physics::gap::gap_m;
use crate::physics::geometry::Solid;
use crate::robot::configuration::Configuration;
use crate::robot::links::{PART_COUNT, part_poses};
use rapier3d::geometry::{Aabb, SharedShape};
use rapier3d::math::{Pose3, Vec3};
use rapier3d::parry::bounding_volume::BoundingVolume;

/// An episode begins on every second of them in either direction: 0.25 m, AI2-THOR's default grid.
const STAND_EVERY: usize = 2;
const SPOT_GRID_M: f32 = 0.025;
/// Room that a target position leaves to everything else, metres.
const SPOT_CLEARANCE_M: f32 = 0.015;
/// Side of a square of points that are judged together: 0.1 m.
const POINTS_JUDGED: usize = 4;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stand {
    pub x_m: f32,
    pub z_m: f32,
    /// Yaw in turns of 45 degrees.
    pub yaw_ticks: i32,
}

#[derive(Debug, Clone, PartialEq)]
pub struct Stands {
    /// Poses whose body and arm touch nothing, in the largest connected part of the free floor.
    pub poses: Vec<Stand>,
    /// Positions of the body's axis, x and z, in that part, metres.
    pub floor: Vec<(f32, f32)>,
    /// Share of the free floor that is connected with the largest part.
    pub connected_share: f32,
}

pub fn stands(floor: (Vec3, Vec3), scene: &FixedScene, movables: &[Aabb], parts: &[Solid; PART_COUNT]) -> Stands {
    let grid = Floor::of(floor, scene, movables);
    let columns = grid.columns();
    let mut poses = Vec::new();
    let component = largest_component(&grid.free, columns);
    let connected_share = component.len() as f32 / grid.free.iter().filter(|&&free| free).count().max(1) as f32;
    let floor = component.iter().map(|&cell| grid.position(cell)).collect();
    for cell in component {
        if !(cell % columns).is_multiple_of(STAND_EVERY) || !(cell / columns).is_multiple_of(STAND_EVERY) {
            continue;
        }
        let (x_m, z_m) = grid.position(cell);
        for yaw_ticks in 0..8 {
            let configuration = Configuration::start(x_m, z_m, yaw_ticks);
            let Ok(part_poses) = part_poses(&configuration.posture()) else { continue };
            // The body was checked above; the arm's links remain.
            let clear = parts.iter().zip(&part_poses).skip(1).all(|(part, pose)| {
                let aabb = part.aabb(pose).loosened(CLEARANCE_M);
                !scene.meets_aabb(&aabb) && !movables.iter().any(|other| other.intersects(&aabb))
            });
            if clear {
                poses.push(Stand { x_m, z_m, yaw_ticks });
            }
        }
    }
    Stands { poses, floor, connected_share }
}

/// Cells of the floor on which episodes can begin: positions in x and z of the body's axis, row by row.
fn stand_cells((low, high): (Vec3, Vec3)) -> impl Iterator<Item = (f32, f32)> {
    let columns = ((high.x - low.x) / CELL_M) as usize;
    let rows = ((high.z - low.z) / CELL_M) as usize;
    let at =
        move |column: usize, row: usize| (low.x + (column as f32 + 0.5) * CELL_M, low.z + (row as f32 + 0.5) * CELL_M);
    (0..rows)
        .step_by(STAND_EVERY)
        .flat_map(move |row| (0..columns).step_by(STAND_EVERY).map(move |column| at(column, row)))
}

/// Robot poses as bits, one a direction, of every cell on which an episode can begin. None if a pose is on no cell.
pub(super) fn stands_as_bits(floor: (Vec3, Vec3), stands: &[Stand]) -> Option<Vec<u8>> {
    let mut rest = stands;
    let bits = stand_cells(floor).map(|(x_m, z_m)| {
        let here = rest.iter().take_while(|stand| stand.x_m == x_m && stand.z_m == z_m).count();
        let (these, later) = rest.split_at(here);
        rest = later;
        these.iter().fold(0, |bits, stand| bits | 1u8 << (stand.yaw_ticks & 7))
    });
    let bits = bits.collect();
    rest.is_empty().then_some(bits)
}

/// What [`stands_as_bits`] made bits of; none if there are not as many cells.
pub(super) fn stands_of_bits(floor: (Vec3, Vec3), bits: &[u8]) -> Option<Vec<Stand>> {
    if stand_cells(floor).count() != bits.len() {
        return None;
    }
    let of_cell = |((x_m, z_m), &bits): ((f32, f32), &u8)| {
        (0..8).filter(move |yaw| bits >> yaw & 1 != 0).map(move |yaw_ticks| Stand { x_m, z_m, yaw_ticks })
    };
    Some(stand_cells(floor).zip(bits).flat_map(of_cell).collect())
}

/// Where a thing would stand on every point of the grid over the surfaces, free or not.
fn grid_spots(surfaces: &[Surface], solid: &Solid) -> impl Iterator<Item = Vec3> {
    let lift = Vec3::new(0.0, DROP_M - solid.aabb(&Pose3::identity()).mins.y, 0.0);
    surfaces.iter().flat_map(move |surface| {
        let columns = ((surface.high.x - surface.low.x) / SPOT_GRID_M) as usize;
        let rows = ((surface.high.z - surface.low.z) / SPOT_GRID_M) as usize;
        let low = surface.low;
        (0..rows).flat_map(move |row| {
            let at =
                move |column: usize| low + Vec3::new(column as f32 + 0.5, 0.0, row as f32 + 0.5) * SPOT_GRID_M + lift;
            (0..columns).map(at)
        })
    })
}

/// A target's places as bits, one a point of the grid over the surfaces. None if a place is on no point.
pub(super) fn spots_as_bits(surfaces: &[Surface], solid: &Solid, spots: &[Vec3]) -> Option<Vec<u8>> {
    let mut rest = spots;
    let mut bits = Vec::new();
    for (index, point) in grid_spots(surfaces, solid).enumerate() {
        if index % 8 == 0 {
            bits.push(0u8);
        }
        if let Some(byte) = bits.last_mut().filter(|_| rest.first() == Some(&point)) {
            *byte |= 1 << (index % 8);
            rest = &rest[1..];
        }
    }
    rest.is_empty().then_some(bits)
}

/// What [`spots_as_bits`] made bits of; none if there are not as many points.
pub(super) fn spots_of_bits(surfaces: &[Surface], solid: &Solid, bits: &[u8]) -> Option<Vec<Vec3>> {
    let mut points = 0;
    let mut spots = Vec::new();
    for (index, point) in grid_spots(surfaces, solid).enumerate() {
        points = index + 1;
        if bits.get(index / 8)? >> (index % 8) & 1 != 0 {
            spots.push(point);
        }
    }
    (bits.len() == usize::div_ceil(points, 8)).then_some(spots)
}

/// Cells of the largest four-connected set of free cells, ascending.
fn largest_component(free: &[bool], columns: usize) -> Vec<usize> {
    let mut seen = vec![false; free.len()];
    let mut best: Vec<usize> = Vec::new();
    for first in 0..free.len() {
        if !free[first] || seen[first] {
            continue;
        }
        let mut component = vec![first];
        seen[first] = true;
        let mut next = 0;
        while next < component.len() {
            let cell = component[next];
            next += 1;
            let column = cell % columns;
            let neighbours = [
                (column > 0).then(|| cell - 1),
                (column + 1 < columns).then_some(cell + 1),
                cell.checked_sub(columns),
                (cell + columns < free.len()).then_some(cell + columns),
            ];
            for neighbour in neighbours.into_iter().flatten() {
                if free[neighbour] && !seen[neighbour] {
                    seen[neighbour] = true;
                    component.push(neighbour);
                }
            }
        }
        if component.len() > best.len() {
            best = component;
        }
    }
    best.sort_unstable();
    best
}

/// Points of a grid over the surfaces that the robot's arm comes to: surface and position on it. Points of one square
/// are judged by its middle.
pub(crate) fn reachable_points<'a>(surfaces: &'a [Surface], reach: &Reach) -> Vec<(&'a Surface, Vec3)> {
    let mut points = Vec::new();
    for surface in surfaces {
        let columns = ((surface.high.x - surface.low.x) / SPOT_GRID_M) as usize;
        let rows = ((surface.high.z - surface.low.z) / SPOT_GRID_M) as usize;
        let at = |column: f32, row: f32| surface.low + Vec3::new(column, 0.0, row) * SPOT_GRID_M;
        let middle = |first: usize, count: usize| 0.5 * (first + (first + POINTS_JUDGED).min(count)) as f32;
        let squares: Vec<Vec<bool>> = (0..rows)
            .step_by(POINTS_JUDGED)
            .map(|row| {
                let comes_to = |column| reach.comes_to(at(middle(column, columns), middle(row, rows)));
                (0..columns).step_by(POINTS_JUDGED).map(comes_to).collect()
            })
            .collect();
        for row in 0..rows {
            for column in 0..columns {
                if squares[row / POINTS_JUDGED][column / POINTS_JUDGED] {
                    points.push((surface, at(column as f32 + 0.5, row as f32 + 0.5)));
                }
            }
        }
    }
    points
}

/// Places where a thing can stand: unturned, on one of the points, clear of everything. `others` are all other
/// movable things.
pub fn target_spots(
    solid: &Solid,
    points: &[(&Surface, Vec3)],
    scene: &FixedScene,
    others: &[(&Solid, &Pose3)],
) -> Vec<Vec3> {
    let about_origin = solid.aabb(&Pose3::identity());
    let own = PlacedPart::of(solid, &Pose3::identity());
    let others: Vec<PlacedPart> = others.iter().flat_map(|(other, pose)| PlacedPart::of(other, pose)).collect();
    let mut spots = Vec::new();
    for on_surface in points.chunk_by(|(a, _), (b, _)| std::ptr::eq(*a, *b)) {
        // Of all that there is, what rises from this surface or hangs over it.
        let surface = on_surface[0].0;
        let reach = about_origin.extents() + Vec3::splat(2.0 * SPOT_CLEARANCE_M);
        let volume = Aabb::new(surface.low - reach, Vec3::new(surface.high.x, surface.low.y, surface.high.z) + reach);
        let fixed: Vec<Aabb> = scene.aabbs().iter().filter(|aabb| aabb.intersects(&volume)).copied().collect();
        let others: Vec<&PlacedPart> = others.iter().filter(|part| part.aabb.intersects(&volume)).collect();
        for (surface, point) in on_surface {
            let spot = *point + Vec3::new(0.0, DROP_M - about_origin.mins.y, 0.0);
            let aabb = Aabb::new(about_origin.mins + spot, about_origin.maxs + spot);
            if !surface.carries(&aabb) {
                continue;
            }
            // Lifted, so that the surface itself does not count as in the way.
            let lift = Vec3::new(0.0, SPOT_CLEARANCE_M, 0.0);
            let wide = aabb.loosened(SPOT_CLEARANCE_M);
            let above = Aabb::new(wide.mins + lift, wide.maxs + lift);
            let crowded = || {
                others
                    .iter()
                    .filter(|other| other.aabb.intersects(&wide))
                    .any(|other| own.iter().any(|part| part.nearer_than(spot, other, SPOT_CLEARANCE_M)))
            };
            if !fixed.iter().any(|other| other.intersects(&above)) && !crowded() {
                spots.push(spot);
            }
        }
    }
    spots
}

struct PlacedPart {
    shape: SharedShape,
    pose: Pose3,
    aabb: Aabb,
}

impl PlacedPart {
    fn of(solid: &Solid, world_from_body: &Pose3) -> Vec<Self> {
        let placed = |(shape, body_from_part): &(SharedShape, Pose3)| {
            let pose = *world_from_body * *body_from_part;
            Self { shape: shape.clone(), pose, aabb: shape.compute_aabb(&pose) }
        };
        solid.parts.iter().map(placed).collect()
    }

    /// Whether this part, moved by `by`, comes nearer to the other one than this.
    fn nearer_than(&self, by: Vec3, other: &Self, distance_m: f32) -> bool {
        let wide = Aabb::new(self.aabb.mins + by, self.aabb.maxs + by).loosened(distance_m);
        let moved = Pose3::from_parts(self.pose.translation + by, self.pose.rotation);
        wide.intersects(&other.aabb) && gap_m(&moved, &self.shape, &other.pose, &other.shape) < distance_m
    }
}
