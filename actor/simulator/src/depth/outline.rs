//! Outlines of convex figures in the image, as the lines that bound them on the left and on the right.
//!
//! In a row a convex figure reaches from the rightmost of its left sides to the leftmost of its right sides: that holds
//! for the lines as they go on beyond their ends, so eight rows are found at once with nothing but multiplications,
//! additions and comparisons.

use super::centres::first_centres;
use super::depth_buffer::DepthBuffer;
use depth::simd::{LANES, Lanes};

/// Corners in the image, [`LANES`] of them.
#[derive(Debug, Clone, Copy)]
pub struct Corners {
    pub x_px: Lanes,
    pub y_px: Lanes,
}

/// A line through a point, x per y.
#[derive(Debug, Clone, Copy)]
struct Line {
    x_px: f32,
    y_px: f32,
    slope: f32,
}

#[derive(Debug, Clone, Default)]
pub struct Outline {
    left: Vec<Line>,
    right: Vec<Line>,
}

impl Outline {
    #[inline(always)]
    pub fn clear(&mut self) {
        self.left.clear();
        self.right.clear();
    }

    /// Adds the sides from each of `from` to the corresponding one of `to`, clockwise on the screen (y down): what
    /// runs down is on the right, what runs up on the left. Sides that pass no row of pixels' centres are left out.
    #[inline(always)]
    pub fn add(&mut self, from: Corners, to: Corners, side: f32) {
        let (from_row, to_row) = (first_centres(from.y_px, side), first_centres(to.y_px, side));
        let (down, up) = (from_row.less(to_row), to_row.less(from_row));
        let slope = ((to.x_px - from.x_px) / (to.y_px - from.y_px)).to_array();
        // From the upper end, whichever way the side runs: neighbours agree.
        let x_px = from.x_px.or_else(down, to.x_px).to_array();
        let y_px = from.y_px.or_else(down, to.y_px).to_array();
        let line = |lane: usize| Line { x_px: x_px[lane], y_px: y_px[lane], slope: slope[lane] };
        for (bits, lines) in [(down.bits(), &mut self.right), (up.bits(), &mut self.left)] {
            let mut bits = bits;
            while bits != 0 {
                lines.push(line(bits.trailing_zeros() as usize));
                bits &= bits - 1;
            }
        }
    }

    /// Adds the sides of a polygon, clockwise on the screen: `count` corners, with room for [`LANES`] more.
    #[inline(always)]
    pub fn add_polygon(&mut self, x_px: &mut [f32], y_px: &mut [f32], count: usize, side: f32) {
        // The first corner again closes it, and once more: sides without length are none.
        for i in count..=count.next_multiple_of(LANES) {
            x_px[i] = x_px[0];
            y_px[i] = y_px[0];
        }
        let load = |from: &[f32]| Lanes::load(from.first_chunk().expect("there is room for LANES more"));
        for i in (0..count).step_by(LANES) {
            let from = Corners { x_px: load(&x_px[i..]), y_px: load(&y_px[i..]) };
            let to = Corners { x_px: load(&x_px[i + 1..]), y_px: load(&y_px[i + 1..]) };
            self.add(from, to, side);
        }
    }

    /// Notes the figure's interval in each row from `top` to before `bottom`.
    #[inline(always)]
    pub fn mark(&self, buffer: &mut DepthBuffer, top: usize, bottom: usize) {
        let limit = buffer.side() as f32;
        let ramp = Lanes::ramp();
        for row in (top..bottom).step_by(LANES) {
            let y_px = Lanes::splat(row as f32 + 0.5) + ramp;
            let at =
                |line: &Line| Lanes::splat(line.x_px) + (y_px - Lanes::splat(line.y_px)) * Lanes::splat(line.slope);
            let left = self.left.iter().fold(Lanes::splat(0.0), |left, line| left.max(at(line)));
            let right = self.right.iter().fold(Lanes::splat(limit), |right, line| right.min(at(line)));
            mark_rows(buffer, row, [left, right]);
        }
    }
}

/// Notes the intervals of [`LANES`] rows: from the first pixel whose centre lies at or beyond the left position to
/// the last before the right one.
#[inline(always)]
pub fn mark_rows(buffer: &mut DepthBuffer, row: usize, [left, right]: [Lanes; 2]) {
    let limit = buffer.side() as f32;
    for (rows, position) in [(&mut buffer.left, left), (&mut buffer.right, right)] {
        let rows = rows[row..].first_chunk_mut().expect("there is room for LANES rows from any row on");
        first_centres(position, limit).store(rows);
    }
}
