//! Round things, drawn by their formula: a sphere from its silhouette's conic, a cylinder from an outline of a few
//! corners. Depth is exact at each pixel whatever the number of corners, which only the silhouette shows.
//!
//! Their radius lies halfway between the circles within and about the finest mesh, so that no point of that mesh is
//! further off than half of what separates the circles.

use super::centres::first_centres;
use super::depth_buffer::{DepthBuffer, Extent, rectangle};
use super::outline::{Outline, mark_rows};
use super::surface::{Ball, Mantle, Plane, Planes};
use super::view::{LEAST_HEIGHT_M, Lens, NEAR_M};
use depth::simd::{LANES, Lanes};
use std::f64::consts::PI;

/// Corners of a ring and the radius in pixels up to which they are enough: the outline deviates by at most 0.15 pixels.
const RINGS: [(usize, f32); 6] = [(8, 3.9), (16, 15.0), (24, 35.0), (32, 62.0), (48, 140.0), (64, f32::MAX)];
/// Most corners of a ring.
const RING_MOST: usize = 64;
/// Corners of an outline: two rings, and room for the vector unit.
const OUTLINE_MOST: usize = 2 * RING_MOST + 2 * LANES;

#[derive(Debug, Clone, Copy)]
pub struct Round {
    /// Radius of the middle between the circles within and about the finest mesh, metres.
    pub radius_m: f32,
    pub half_height_m: f32,
}

impl Round {
    /// A cylinder whose mesh has this many sides.
    pub fn cylinder(radius_m: f32, half_height_m: f32, sides: usize) -> Self {
        let within = libm::cos(PI / sides as f64);
        Self { radius_m: (f64::from(radius_m) * f64::midpoint(1.0, within)) as f32, half_height_m }
    }

    /// A sphere whose mesh has this many sides: bent both ways, the mesh deviates twice as far.
    pub fn sphere(radius_m: f32, sides: usize) -> Self {
        let within = libm::cos(PI / sides as f64);
        Self { radius_m: (f64::from(radius_m) * within) as f32, half_height_m: 0.0 }
    }
}

/// The corners of a ring: (cos, sin) of the angles (i + ½) 2π / count.
#[derive(Debug, Clone)]
struct Ring {
    count: usize,
    cos: [f32; RING_MOST],
    sin: [f32; RING_MOST],
    /// Cosine of i 2π / count: of the middle of side i.
    middle_cos: [f32; RING_MOST / 4 + 1],
    /// Radius of the corners for a circle of radius 1 between those within and about the ring, and of the sides.
    corner_radius: f32,
    side_radius: f32,
}

/// Draws cylinders; its buffers live from call to call.
#[derive(Debug, Clone)]
pub struct RoundBrush {
    rings: Vec<Ring>,
    x_px: [f32; OUTLINE_MOST],
    y_px: [f32; OUTLINE_MOST],
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// `a + k · b`.
fn sum(a: [f32; 3], k: f32, b: [f32; 3]) -> [f32; 3] {
    [a[0] + k * b[0], a[1] + k * b[1], a[2] + k * b[2]]
}

impl RoundBrush {
    pub fn new() -> Self {
        let rings = RINGS
            .iter()
            .map(|&(count, _)| {
                let angle = |i: f64| 2.0 * PI * i / count as f64;
                let within = libm::cos(PI / count as f64);
                let corner_radius = 2.0 / (1.0 + within);
                Ring {
                    count,
                    cos: std::array::from_fn(|i| libm::cos(angle(i as f64 + 0.5)) as f32),
                    sin: std::array::from_fn(|i| libm::sin(angle(i as f64 + 0.5)) as f32),
                    middle_cos: std::array::from_fn(|i| libm::cos(angle(i as f64)) as f32),
                    corner_radius: corner_radius as f32,
                    side_radius: (corner_radius * within) as f32,
                }
            })
            .collect();
        Self { rings, x_px: [0.0; OUTLINE_MOST], y_px: [0.0; OUTLINE_MOST] }
    }

    /// Draws a cylinder that lies beyond the near plane; its centre and the unit vector along its axis in the camera's
    /// frame.
    pub fn cylinder(
        &mut self,
        buffer: &mut DepthBuffer,
        outline: &mut Outline,
        lens: Lens,
        centre: [f32; 3],
        axis: [f32; 3],
        round: Round,
    ) {
        let Round { radius_m, half_height_m } = round;
        // The eye in the cylinder's own directions: along the axis, and away from it (u); v is at right angles.
        let eye_along_m = -dot(centre, axis);
        let away = sum(centre, eye_along_m, axis).map(|v| -v);
        let away_m = dot(away, away).sqrt();
        let u = if away_m > LEAST_HEIGHT_M { away.map(|v| v / away_m) } else { any_across(axis) };
        let v = cross(axis, u);
        let cap = cap_seen(lens, axis, eye_along_m, half_height_m);

        let nearest_m = centre[2] - (radius_m + half_height_m);
        let nearest_m = if nearest_m > NEAR_M { nearest_m } else { NEAR_M };
        let radius_px = radius_m * lens.focal_px / nearest_m;
        let which = RINGS.iter().position(|&(_, enough_px)| radius_px <= enough_px).unwrap_or(RINGS.len() - 1);
        let ring = &self.rings[which];
        let (mut top_x, mut top_y) = ([0.0; RING_MOST], [0.0; RING_MOST]);
        let (mut bottom_x, mut bottom_y) = ([0.0; RING_MOST], [0.0; RING_MOST]);
        let corner_m = ring.corner_radius * radius_m;
        let (across_u, across_v) = (u.map(|v| Lanes::splat(v * corner_m)), v.map(|v| Lanes::splat(v * corner_m)));
        let top = sum(centre, half_height_m, axis).map(Lanes::splat);
        let bottom = sum(centre, -half_height_m, axis).map(Lanes::splat);
        let (mut farthest, mut nearest) = (Lanes::splat(f32::MAX), Lanes::splat(0.0));
        let (mut low, mut high) = ([Lanes::splat(f32::MAX); 2], [Lanes::splat(f32::MIN); 2]);
        for block in (0..ring.count).step_by(LANES) {
            let table =
                |table: &[f32; RING_MOST]| Lanes::load(table[block..].first_chunk().expect("counts are multiples"));
            let (cos, sin) = (table(&ring.cos), table(&ring.sin));
            let out = [0, 1, 2].map(|i| across_u[i] * cos + across_v[i] * sin);
            for (end, x_px, y_px) in [(top, &mut top_x, &mut top_y), (bottom, &mut bottom_x, &mut bottom_y)] {
                let (corners, inverse_m) = lens.project_lanes([0, 1, 2].map(|i| end[i] + out[i]));
                farthest = farthest.min(inverse_m);
                nearest = nearest.max(inverse_m);
                low = [low[0].min(corners.x_px), low[1].min(corners.y_px)];
                high = [high[0].max(corners.x_px), high[1].max(corners.y_px)];
                corners.x_px.store(x_px[block..].first_chunk_mut().expect("counts are multiples"));
                corners.y_px.store(y_px[block..].first_chunk_mut().expect("counts are multiples"));
            }
        }
        let Some([_, _, first_row, end_row]) = rectangle(low, high, buffer.side() as f32) else { return };
        let (first_row, end_row) = (first_row as usize, end_row as usize);

        // Sides turn away from the eye beyond ± some number of the one that faces it.
        let turned = ring.side_radius * radius_m;
        let facing = ring.middle_cos[..=ring.count / 4].iter().take_while(|&&cos| turned < away_m * cos).count();
        // Only a cap is seen, if any.
        if facing == 0 && cap.is_none() {
            return;
        }
        let rings = [[&top_x, &top_y], [&bottom_x, &bottom_y]];
        let used = self.silhouette(ring.count, facing, rings, eye_along_m, half_height_m);
        outline.clear();
        outline.add_polygon(&mut self.x_px, &mut self.y_px, used, buffer.side() as f32);
        outline.mark(buffer, first_row, end_row);
        // The mantle is bent: it comes nearer than the ring's corners by less than its radius.
        let inverse_m = [farthest.smallest(), nearest.largest() / (1.0 - radius_m * nearest.largest()).max(0.5)];
        let extent = Extent { top: first_row, bottom: end_row, inverse_m };
        let outside_m2 = away_m * away_m - radius_m * radius_m;
        match cap {
            Some(cap) if facing == 0 || outside_m2 <= 0.0 => buffer.sweep(extent, &mut Planes::new([cap])),
            cap => {
                let scale = 1.0 / outside_m2;
                let tangent_m = outside_m2.sqrt();
                let outside = lens.over_image(u.map(|v| v * (-away_m * scale)));
                let root = [-tangent_m, tangent_m]
                    .map(|tangent_m| lens.over_image([0, 1, 2].map(|i| (radius_m * u[i] + tangent_m * v[i]) * scale)));
                buffer.sweep(extent, &mut Mantle::new(outside, root, cap));
            }
        }
    }

    /// Lists the corners about the figure, clockwise on the screen, and returns their number. The mantle has `count`
    /// sides; those less than `facing` sides away from the one that faces the eye are seen. The corners of the top's
    /// and the bottom's ring are given as they lie in the image.
    #[inline(always)]
    fn silhouette(
        &mut self,
        count: usize,
        facing: usize,
        [top, bottom]: [[&[f32; RING_MOST]; 2]; 2],
        eye_along_m: f32,
        half_height_m: f32,
    ) -> usize {
        let mut used = 0;
        let mut take = |from_top: bool, index: usize| {
            let [x_px, y_px] = if from_top { top } else { bottom };
            self.x_px[used] = x_px[index];
            self.y_px[used] = y_px[index];
            used += 1;
        };
        if facing == 0 {
            let from_top = eye_along_m - half_height_m > 0.0;
            (0..count).for_each(|i| take(from_top, if from_top { i } else { count - 1 - i }));
        } else {
            // From the corner before the first side that faces the eye to the one after the last: along the bottom,
            // and back along the top; along the side that is nearer where that bounds the figure.
            let (first, last) = (count - facing, facing - 1);
            if eye_along_m > -half_height_m {
                (first..count).chain(0..=last).for_each(|i| take(false, i));
            } else {
                (last..=first).rev().for_each(|i| take(false, i));
            }
            if eye_along_m < half_height_m {
                (first..count).chain(0..=last).rev().for_each(|i| take(true, i));
            } else {
                (last..=first).for_each(|i| take(true, i));
            }
        }
        used
    }
}

/// The plane of the cap that looks at the eye, if one of the two does.
#[inline(always)]
fn cap_seen(lens: Lens, axis: [f32; 3], eye_along_m: f32, half_height_m: f32) -> Option<Plane> {
    let (above_top_m, below_bottom_m) = (eye_along_m - half_height_m, -eye_along_m - half_height_m);
    if above_top_m > LEAST_HEIGHT_M {
        Some(lens.plane(axis, above_top_m))
    } else if below_bottom_m > LEAST_HEIGHT_M {
        Some(lens.plane(axis.map(|v| -v), below_bottom_m))
    } else {
        None
    }
}

/// Draws a sphere that lies beyond the near plane; its centre in the camera's frame.
pub fn sphere(buffer: &mut DepthBuffer, lens: Lens, centre: [f32; 3], round: Round) {
    let radius_m = round.radius_m;
    let [x, y, z] = centre;
    let side = buffer.side() as f32;
    // Tangent planes through the eye that are level: y / z of where the sphere is seen highest and lowest.
    let square = radius_m * radius_m;
    let reach = radius_m * (y * y + z * z - square).max(0.0).sqrt();
    let per_depth = lens.focal_px / (z * z - square);
    let rows = Lanes::load(&[y * z + reach, y * z - reach, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let rows = Lanes::splat(lens.centre_px) - rows * Lanes::splat(per_depth);
    let rows = first_centres(rows, side).to_array();
    let (top, bottom) = (rows[0] as usize, rows[1] as usize);
    if top >= bottom {
        return;
    }
    let outside_m2 = dot(centre, centre) - square;
    let scale = 1.0 / outside_m2;
    let per_focal = 1.0 / lens.focal_px;
    let per_z = 1.0 / z;
    let outside = lens.over_image(centre.map(|v| v * scale));
    let centre_px = [lens.centre_px + lens.focal_px * x * per_z, lens.centre_px - lens.focal_px * y * per_z];
    // ((d · c)² − (c² − r²) d²) / (c² − r²)² about the direction in which the centre is seen.
    let (first, second) = (2.0 * square * per_z * per_focal, per_focal * per_focal);
    let quadratic = [
        square * dot(centre, centre) * per_z * per_z,
        first * x,
        -first * y,
        (x * x - outside_m2) * second,
        -2.0 * x * y * second,
        (y * y - outside_m2) * second,
    ]
    .map(|coefficient| coefficient * scale * scale);
    let mut ball = Ball::new(outside, centre_px, quadratic);
    for row in (top..bottom).step_by(LANES) {
        let interval = ball.interval(row as f32 + 0.5);
        mark_rows(buffer, row, interval);
    }
    let inverse_m = [1.0 / (z + radius_m), 1.0 / (z - radius_m)];
    buffer.sweep(Extent { top, bottom, inverse_m }, &mut ball);
}

/// Some unit vector at right angles to a unit vector.
fn any_across(axis: [f32; 3]) -> [f32; 3] {
    let other = if axis[0].abs() < 0.6 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
    let across = cross(axis, other);
    let length = dot(across, across).sqrt();
    across.map(|v| v / length)
}
