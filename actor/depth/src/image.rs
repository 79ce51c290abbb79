//! The image while it is drawn: the largest inverse depth so far at each pixel, and what has it.
//!
//! Inverse depth is affine over the image of a plane, and the nearest surface is its maximum. An empty pixel has that
//! of the far plane, so that what lies beyond never wins.

use crate::camera::{Lens, Rectangle};
use crate::simd::{LANES, Lanes};
use crate::surface::Surface;

/// Largest depth in whole millimetres: signed and unsigned 16-bit readers agree on it.
pub const DEPTH_MAX_MM: u16 = 32_766;
/// Pixels along the edge of a tile.
const TILE: usize = LANES;

#[derive(Debug, Clone, Default)]
pub(crate) struct Image {
    width: usize,
    height: usize,
    /// Numbers in a row: at least [`LANES`] more than pixels, so that eight can be read from any pixel on. Those hold
    /// [`f32::MAX`], which nothing is before.
    stride: usize,
    inverse_m: Vec<f32>,
    /// Bits of the number of what is seen; anything where nothing is.
    shown: Vec<f32>,
    /// First pixel of the figure at hand in each row, and the one after its last: whole numbers in 0..=width.
    pub left: Vec<f32>,
    pub right: Vec<f32>,
    /// Inverse depths of the near and the far plane.
    pub nearest: f32,
    farthest: f32,
    /// The least inverse depth in each tile, or less; and whether something was drawn there since.
    tiles: Vec<f32>,
    stale: Vec<bool>,
    tiles_in_row: usize,
}

impl Image {
    pub fn begin(&mut self, lens: &Lens) {
        let (width, height) = (lens.width, lens.height);
        if (self.width, self.height) != (width, height) {
            let stride = width.next_multiple_of(LANES) + LANES;
            let tiles_in_row = width.div_ceil(TILE);
            *self = Self {
                width,
                height,
                stride,
                inverse_m: vec![f32::MAX; stride * height],
                shown: vec![0.0; stride * height],
                left: vec![0.0; height + LANES],
                right: vec![0.0; height + LANES],
                tiles_in_row,
                tiles: vec![0.0; tiles_in_row * height.div_ceil(TILE)],
                stale: vec![false; tiles_in_row * height.div_ceil(TILE)],
                ..Self::default()
            };
        }
        (self.nearest, self.farthest) = ((1.0 / lens.near_m) as f32, (1.0 / lens.far_m) as f32);
        for row in self.inverse_m.chunks_exact_mut(self.stride) {
            row[..width].fill(self.farthest);
        }
        self.tiles.fill(self.farthest);
        self.stale.fill(false);
    }

    pub fn width(&self) -> usize {
        self.width
    }

    pub fn height(&self) -> usize {
        self.height
    }

    /// Eight pixels from this one on: those of `value` that lie before what is there are seen from now on.
    #[inline(always)]
    pub fn put(&mut self, row: usize, column: usize, value: Lanes, number: Lanes) {
        let start = row * self.stride + column;
        let group: &mut [f32; LANES] = self.inverse_m[start..].first_chunk_mut().expect("rows have room for eight");
        let before = Lanes::load(group);
        let wins = before.less(value);
        if wins.bits() != 0 {
            value.or_else(wins, before).store(group);
            let shown = self.shown[start..].first_chunk_mut().expect("rows have room for eight");
            number.or_else(wins, Lanes::load(shown)).store(shown);
        }
    }

    /// Draws a surface into the intervals of these rows.
    #[inline(always)]
    pub fn sweep(&mut self, top: usize, bottom: usize, surface: &mut impl Surface, number: u32) {
        let number = Lanes::splat(f32::from_bits(number));
        let nearest = Lanes::splat(self.nearest);
        for row in top..bottom {
            let (left, right) = (self.left[row], self.right[row]);
            if left >= right {
                continue;
            }
            surface.begin_row(row as f32 + 0.5);
            let (first, end) = (left as i32 as usize, right as i32 as usize);
            let mut x_px = Lanes::splat(left + 0.5) + Lanes::ramp();
            for column in (first..end).step_by(LANES) {
                let value = surface.inverse_m(x_px);
                let value = value.only(value.less(nearest));
                let value = if end - column < LANES { value.only(x_px.less(Lanes::splat(right))) } else { value };
                self.put(row, column, value, number);
                x_px = x_px + Lanes::splat(LANES as f32);
            }
        }
    }

    pub fn touch(&mut self, at: Rectangle) {
        for row in at.top / TILE..at.bottom.div_ceil(TILE) {
            let row = row * self.tiles_in_row;
            self.stale[row + at.left / TILE..row + at.right.div_ceil(TILE)].fill(true);
        }
    }

    /// Whether everything here lies before this inverse depth.
    pub fn hides(&mut self, at: Rectangle, inverse_m: f32) -> bool {
        for row in at.top / TILE..at.bottom.div_ceil(TILE) {
            for column in at.left / TILE..at.right.div_ceil(TILE) {
                let tile = row * self.tiles_in_row + column;
                if self.tiles[tile] < inverse_m && self.stale[tile] {
                    self.tiles[tile] = self.least_of_tile(row, column);
                    self.stale[tile] = false;
                }
                if self.tiles[tile] < inverse_m {
                    return false;
                }
            }
        }
        true
    }

    fn least_of_tile(&self, row: usize, column: usize) -> f32 {
        let mut least = Lanes::splat(f32::MAX);
        for row in row * TILE..((row + 1) * TILE).min(self.height) {
            let group = self.inverse_m[row * self.stride + column * TILE..].first_chunk();
            least = least.min(Lanes::load(group.expect("rows have room for eight")));
        }
        least.smallest()
    }

    /// Depth in millimetres, rounded, at most [`DEPTH_MAX_MM`]; 0 where nothing is.
    pub fn millimetres(&self, depth_mm: &mut [u16]) {
        // Below 2²³, adding 2²³ leaves a whole number, the nearest.
        let round = Lanes::splat(8_388_608.0);
        let most = Lanes::splat(f32::from(DEPTH_MAX_MM));
        self.each_group(depth_mm, |inverse_m, seen| {
            let depth = (Lanes::splat(1000.0) / inverse_m).min(most);
            (depth + round - round).only(seen).to_u16()
        });
    }

    /// Depth in metres; 0 where nothing is.
    pub fn metres(&self, depth_m: &mut [f32]) {
        self.each_group(depth_m, |inverse_m, seen| (Lanes::splat(1.0) / inverse_m).only(seen).to_array());
    }

    #[inline(always)]
    fn each_group<T: Copy>(&self, out: &mut [T], of: impl Fn(Lanes, crate::simd::Mask) -> [T; LANES]) {
        assert_eq!(out.len(), self.width * self.height, "the frame has the lens's size");
        let farthest = Lanes::splat(self.farthest);
        for (row, out) in self.inverse_m.chunks_exact(self.stride).zip(out.chunks_exact_mut(self.width)) {
            for (group, out) in row.as_chunks::<LANES>().0.iter().zip(out.chunks_mut(LANES)) {
                let inverse_m = Lanes::load(group);
                let values = of(inverse_m, farthest.less(inverse_m));
                if let Ok(out) = <&mut [T; LANES]>::try_from(&mut *out) {
                    *out = values;
                } else {
                    out.copy_from_slice(&values[..out.len()]);
                }
            }
        }
    }

    /// The number of what is seen at each pixel; -1 where nothing is.
    pub fn numbers(&self, numbers: &mut [i32]) {
        assert_eq!(numbers.len(), self.width * self.height, "the frame has the lens's size");
        let rows = self.inverse_m.chunks_exact(self.stride).zip(self.shown.chunks_exact(self.stride));
        for ((row, shown), out) in rows.zip(numbers.chunks_exact_mut(self.width)) {
            for ((inverse_m, shown), out) in row.iter().zip(shown).zip(out) {
                *out = if *inverse_m > self.farthest { shown.to_bits().cast_signed() } else { -1 };
            }
        }
    }
}
