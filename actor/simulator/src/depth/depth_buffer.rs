//! The image while it is drawn: a buffer of inverse depths, and figures with one interval of pixels in each row.
//!
//! A pixel belongs to a figure if its centre lies inside, where a centre exactly on an edge belongs to the side to its
//! right (or below): polygons that share an edge neither overlap nor leave a gap, because both compute the edge from
//! its upper to its lower end.

use super::centres::{first_centre, first_centres, least, most};
use super::surface::{Plane, Planes, Surface};
use depth::simd::{LANES, Lanes};
use proto::camera::WINDOW;

/// Largest depth a pixel can hold, millimetres: signed and unsigned 16-bit readers agree on it.
pub const DEPTH_MAX_MM: u16 = 32_766;

/// A corner in the image: pixels from the top left, and inverse depth, 1/m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Corner {
    pub x_px: f32,
    pub y_px: f32,
    pub inverse_m: f32,
    /// First row whose centre lies at or below the corner, limited to 0..=side.
    row: u32,
}

impl Corner {
    pub fn new(x_px: f32, y_px: f32, inverse_m: f32, side: usize) -> Self {
        Self { x_px, y_px, inverse_m, row: first_centre(y_px, side as f32) as u32 }
    }
}

/// Rows of the image, and the least and greatest inverse depth that what is drawn in them can have, 1/m. (The plane of
/// a face seen edge-on is ill-conditioned; its corners are not.)
#[derive(Debug, Clone, Copy)]
pub struct Extent {
    pub top: usize,
    pub bottom: usize,
    pub inverse_m: [f32; 2],
}

/// The image while it is drawn: the largest inverse depth so far at each pixel, 0 where nothing was drawn.
#[derive(Debug, Clone)]
pub struct DepthBuffer {
    side: usize,
    /// Groups of pixels in a row: rows are padded to a multiple of [`LANES`].
    groups: usize,
    inverse_m: Vec<[f32; LANES]>,
    /// First pixel of the current figure in each row, and the one after its last: whole numbers in 0..=side.
    pub left: Vec<f32>,
    pub right: Vec<f32>,
    /// Rows that anything was drawn in: from the first to before the last.
    drawn: [usize; 2],
}

const NO_ROWS: [usize; 2] = [usize::MAX, 0];

impl DepthBuffer {
    pub fn new(side: usize) -> Self {
        let groups = side.div_ceil(LANES);
        // Intervals are computed for LANES rows at a time, from any row on.
        let rows = side + LANES;
        Self {
            side,
            groups,
            inverse_m: vec![[0.0; LANES]; groups * side],
            left: vec![0.0; rows],
            right: vec![0.0; rows],
            drawn: NO_ROWS,
        }
    }

    pub fn side(&self) -> usize {
        self.side
    }

    /// Draws a convex polygon that runs clockwise on the screen (y down) and lies in `plane`.
    pub fn fill(&mut self, corners: &[Corner], plane: Plane) {
        let limit = self.side as f32;
        let (mut top, mut bottom) = (u32::MAX, 0);
        let (mut x_min, mut x_max) = (f32::MAX, f32::MIN);
        let (mut nearest, mut farthest) = (f32::MIN, f32::MAX);
        for corner in corners {
            top = top.min(corner.row);
            bottom = bottom.max(corner.row);
            x_min = least(x_min, corner.x_px);
            x_max = most(x_max, corner.x_px);
            nearest = most(nearest, corner.inverse_m);
            farthest = least(farthest, corner.inverse_m);
        }
        if top >= bottom || first_centre(x_min, limit) >= first_centre(x_max, limit) {
            return;
        }
        for i in 0..corners.len() {
            let (a, b) = (corners[i], corners[if i + 1 == corners.len() { 0 } else { i + 1 }]);
            // On the screen, clockwise: what runs down is on the right, what runs up on the left.
            if a.row < b.row {
                edge(a, b, limit, &mut self.right);
            } else if b.row < a.row {
                edge(b, a, limit, &mut self.left);
            }
        }
        let extent = Extent { top: top as usize, bottom: bottom as usize, inverse_m: [farthest, nearest] };
        self.sweep(extent, &mut Planes::new([plane]));
    }

    /// Draws a surface into the intervals of these rows.
    #[inline(always)]
    pub fn sweep(&mut self, extent: Extent, surface: &mut impl Surface) {
        let (farthest, nearest) = (Lanes::splat(extent.inverse_m[0]), Lanes::splat(extent.inverse_m[1]));
        let step = Lanes::splat(LANES as f32);
        self.drawn = [self.drawn[0].min(extent.top), self.drawn[1].max(extent.bottom)];
        for row in extent.top..extent.bottom {
            let (left, right) = (self.left[row], self.right[row]);
            if left >= right {
                continue;
            }
            surface.begin_row(row as f32 + 0.5);
            let (first, end) = (left as i32 as usize / LANES, (right as i32 as usize).div_ceil(LANES));
            let groups = &mut self.inverse_m[row * self.groups..][first..end];
            let mut x_px = Lanes::splat((first * LANES) as f32 + 0.5) + Lanes::ramp();
            let (left, right) = (Lanes::splat(left), Lanes::splat(right));
            let (last, others) = groups.split_last_mut().expect("an interval that is not empty has a group");
            let mut others = others.iter_mut();
            if let Some(group) = others.next() {
                let value = surface.inverse_m(x_px).min(nearest).max(farthest).only(left.less(x_px));
                Lanes::load(group).max(value).store(group);
                x_px = x_px + step;
            }
            for group in others {
                let value = surface.inverse_m(x_px).min(nearest).max(farthest);
                Lanes::load(group).max(value).store(group);
                x_px = x_px + step;
            }
            let inside = left.less(x_px).and(x_px.less(right));
            let value = surface.inverse_m(x_px).min(nearest).max(farthest).only(inside);
            Lanes::load(last).max(value).store(last);
        }
    }

    /// Turns the image into millimetres, row-major from the top left, and clears it for the next one.
    pub fn finish(&mut self, depth_mm: &mut [u16]) {
        assert_eq!(depth_mm.len(), self.side * self.side, "the frame is a square of this side");
        let zero = Lanes::splat(0.0);
        for (row, out) in self.inverse_m.chunks_exact_mut(self.groups).zip(depth_mm.chunks_exact_mut(self.side)) {
            for (group, out) in row.iter_mut().zip(out.chunks_mut(LANES)) {
                let millimetres = millimetres(Lanes::load(group));
                zero.store(group);
                if let Ok(out) = <&mut [u16; LANES]>::try_from(&mut *out) {
                    *out = millimetres;
                } else {
                    for (out, value) in out.iter_mut().zip(millimetres) {
                        *out = value;
                    }
                }
            }
        }
        self.drawn = NO_ROWS;
    }

    /// Puts the image before another one in millimetres, and clears it for the next one.
    pub fn put_before(&mut self, depth_mm: &mut [u16]) {
        assert_eq!(depth_mm.len(), self.side * self.side, "the frame is a square of this side");
        let zero = Lanes::splat(0.0);
        let rows = self.inverse_m.chunks_exact_mut(self.groups).zip(depth_mm.chunks_exact_mut(self.side));
        let [top, bottom] = self.drawn;
        for (row, out) in rows.take(bottom).skip(top) {
            for (group, out) in row.iter_mut().zip(out.chunks_mut(LANES)) {
                let inverse_m = Lanes::load(group);
                if zero.less(inverse_m).bits() == 0 {
                    continue;
                }
                zero.store(group);
                for (out, before) in out.iter_mut().zip(millimetres(inverse_m)) {
                    *out = nearer(*out, before);
                }
            }
        }
        self.drawn = NO_ROWS;
    }

    /// Puts the image before another one of which the sums of windows of 2 × 2 pixels are known, and clears it for the
    /// next one: `behind_mm` is the other one, `sums_mm` has its sums, and those of both together afterwards. Returns
    /// whether the new ones fit into 16 bits.
    pub fn put_before_sums(&mut self, behind_mm: &[u16], sums_mm: &mut [u16]) -> bool {
        const WINDOWS: usize = LANES / WINDOW;
        let side = self.side;
        assert!(side.is_multiple_of(LANES) && side.is_multiple_of(WINDOW), "groups of pixels are whole windows");
        assert!(
            behind_mm.len() == side * side && sums_mm.len() * WINDOW * WINDOW == side * side,
            "both are of this side"
        );
        let zero = Lanes::splat(0.0);
        let mut bits = 0;
        let [top, bottom] = self.drawn;
        let bands = self.inverse_m.chunks_exact_mut(WINDOW * self.groups).zip(behind_mm.chunks_exact(WINDOW * side));
        let bands = bands.zip(sums_mm.chunks_exact_mut(side / WINDOW));
        for ((band, behind_mm), sums_mm) in bands.take(bottom.div_ceil(WINDOW)).skip(top / WINDOW) {
            let (upper, lower) = band.split_at_mut(self.groups);
            let (upper_mm, lower_mm) = behind_mm.split_at(side);
            let groups = upper.iter_mut().zip(lower).zip(sums_mm.as_chunks_mut::<WINDOWS>().0);
            let behind = upper_mm.as_chunks::<LANES>().0.iter().zip(lower_mm.as_chunks::<LANES>().0);
            for (((upper, lower), sums_mm), (upper_mm, lower_mm)) in groups.zip(behind) {
                let inverse_m = [Lanes::load(upper), Lanes::load(lower)];
                if inverse_m.iter().all(|&row| zero.less(row).bits() == 0) {
                    continue;
                }
                zero.store(upper);
                zero.store(lower);
                let [above, below] = inverse_m.map(millimetres);
                for (window, sum_mm) in sums_mm.iter_mut().enumerate() {
                    let mut sum = 0;
                    for pixel in WINDOW * window..WINDOW * (window + 1) {
                        sum += u32::from(nearer(upper_mm[pixel], above[pixel]));
                        sum += u32::from(nearer(lower_mm[pixel], below[pixel]));
                    }
                    bits |= sum;
                    *sum_mm = sum as u16;
                }
            }
        }
        self.drawn = NO_ROWS;
        u16::try_from(bits).is_ok()
    }
}

/// The nearer of two depths, where 0 is nothing.
fn nearer(a_mm: u16, b_mm: u16) -> u16 {
    a_mm.wrapping_sub(1).min(b_mm.wrapping_sub(1)).wrapping_add(1)
}

/// The first and one past the last column, and row, with centres between the least and greatest x and y, if there are
/// any.
#[inline(always)]
pub fn rectangle(low: [Lanes; 2], high: [Lanes; 2], side: f32) -> Option<[f32; 4]> {
    let [left, top] = low.map(Lanes::smallest);
    let [right, bottom] = high.map(Lanes::largest);
    let bounds = Lanes::load(&[left, right, top, bottom, 0.0, 0.0, 0.0, 0.0]);
    let [left, right, top, bottom, ..] = first_centres(bounds, side).to_array();
    (left < right && top < bottom).then_some([left, right, top, bottom])
}

/// Depths in millimetres, rounded, at most [`DEPTH_MAX_MM`]; 0 for an inverse depth of 0.
#[inline(always)]
fn millimetres(inverse_m: Lanes) -> [u16; LANES] {
    // Below 2²³, adding 2²³ leaves a whole number, the nearest.
    let round = Lanes::splat(8_388_608.0);
    let depth = (Lanes::splat(1000.0) / inverse_m).min(Lanes::splat(f32::from(DEPTH_MAX_MM)));
    (depth + round - round).only(Lanes::splat(0.0).less(inverse_m)).to_u16()
}

/// Notes where an edge crosses each row of pixel centres between its ends; `upper` is the one with the smaller y.
fn edge(upper: Corner, lower: Corner, limit: f32, crossing: &mut [f32]) {
    let slope = (lower.x_px - upper.x_px) / (lower.y_px - upper.y_px);
    let rows = upper.row as usize..lower.row as usize;
    for (row, crossing) in rows.clone().zip(&mut crossing[rows]) {
        let x = upper.x_px + (row as i32 as f32 + 0.5 - upper.y_px) * slope;
        *crossing = first_centre(x, limit);
    }
}
