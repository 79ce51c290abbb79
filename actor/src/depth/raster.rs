//! Convex polygons filled into a buffer of inverse depths.
//!
//! A pixel belongs to a polygon if its centre lies inside, where a centre exactly on an edge belongs to the side
//! to its right (or below): faces that share an edge neither overlap nor leave a gap, because both compute the edge
//! from its upper to its lower end.

use std::mem::MaybeUninit;

/// Largest depth a pixel can hold, millimetres: signed and unsigned 16-bit readers agree on it.
pub const DEPTH_MAX_MM: u16 = 32_766;
/// Pixels that are worked on at once; rows are padded to a multiple.
const LANES: usize = 8;
/// Horizontal offsets of the pixels of a group.
const LANE_OFFSET: [f32; LANES] = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];

/// A corner in the image: pixels from the top left, and inverse depth, 1/m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Corner {
    pub x_px: f32,
    pub y_px: f32,
    pub inverse_m: f32,
}

/// Inverse depth over the image of a plane: `at_origin + per_x · x + per_y · y`, with x and y in pixels from the top
/// left of the image.
#[derive(Debug, Clone, Copy)]
pub struct Plane {
    pub at_origin: f32,
    pub per_x: f32,
    pub per_y: f32,
}

/// The image while it is drawn: the largest inverse depth so far at each pixel, 0 where nothing was drawn.
#[derive(Debug, Clone)]
pub struct Raster {
    side: usize,
    /// Groups of pixels in a row.
    groups: usize,
    inverse_m: Vec<[f32; LANES]>,
    /// First pixel of the current polygon in each row, and the one after its last.
    left: Vec<i32>,
    right: Vec<i32>,
}

impl Raster {
    /// An empty image.
    pub fn new(side: usize) -> Self {
        let groups = side.div_ceil(LANES);
        Self {
            side,
            groups,
            inverse_m: vec![[0.0; LANES]; groups * side],
            left: vec![0; side],
            right: vec![0; side],
        }
    }

    /// Pixels along an edge.
    pub fn side(&self) -> usize {
        self.side
    }

    /// Draws a convex polygon that runs clockwise on the screen (y down) and lies in `plane`.
    pub fn fill(&mut self, corners: &[Corner], plane: Plane) {
        let limit = self.side as f32;
        let (mut x_min, mut x_max, mut y_min, mut y_max) = (f32::MAX, f32::MIN, f32::MAX, f32::MIN);
        let (mut nearest, mut farthest) = (f32::MIN, f32::MAX);
        for corner in corners {
            x_min = x_min.min(corner.x_px);
            x_max = x_max.max(corner.x_px);
            y_min = y_min.min(corner.y_px);
            y_max = y_max.max(corner.y_px);
            nearest = nearest.max(corner.inverse_m);
            farthest = farthest.min(corner.inverse_m);
        }
        if x_max <= 0.0 || x_min >= limit || y_max <= 0.0 || y_min >= limit {
            return;
        }
        let top = first_centre(y_min, self.side);
        let bottom = first_centre(y_max, self.side);
        if top >= bottom || first_centre(x_min, self.side) >= first_centre(x_max, self.side) {
            return;
        }
        for i in 0..corners.len() {
            let (a, b) = (corners[i], corners[if i + 1 == corners.len() { 0 } else { i + 1 }]);
            // On the screen, clockwise: what runs down is on the right, what runs up on the left.
            if a.y_px < b.y_px {
                edge(a, b, limit, &mut self.right);
            } else {
                edge(b, a, limit, &mut self.left);
            }
        }
        for row in top..bottom {
            let (left, right) = (self.left[row], self.right[row]);
            if left >= right {
                continue;
            }
            let (left, right) = (left as usize, right as usize);
            let at_row = plane.at_origin + plane.per_y * (row as f32 + 0.5);
            let groups = &mut self.inverse_m[row * self.groups..][left / LANES..right.div_ceil(LANES)];
            let (from, to) = (left as f32, right as f32);
            for (offset, group) in groups.iter_mut().enumerate() {
                let start = ((left / LANES + offset) * LANES) as f32;
                for lane in 0..LANES {
                    let x = start + LANE_OFFSET[lane];
                    // The plane of a face seen edge-on is ill-conditioned; its corners are not.
                    let inverse = (at_row + plane.per_x * (x + 0.5)).min(nearest).max(farthest);
                    let inside = x >= from && x < to;
                    group[lane] = group[lane].max(if inside { inverse } else { 0.0 });
                }
            }
        }
    }

    /// Turns the image into millimetres, row-major from the top left, and clears it for the next one.
    pub fn finish<'a>(&mut self, depth_mm: &'a mut [MaybeUninit<u16>]) -> &'a [u16] {
        assert_eq!(depth_mm.len(), self.side * self.side, "the frame is a square of this side");
        for (row, out) in self.inverse_m.chunks_exact_mut(self.groups).zip(depth_mm.chunks_exact_mut(self.side)) {
            for (group, out) in row.iter_mut().zip(out.chunks_mut(LANES)) {
                let millimetres = group.map(millimetres);
                *group = [0.0; LANES];
                if let Ok(out) = <&mut [MaybeUninit<u16>; LANES]>::try_from(&mut *out) {
                    *out = millimetres.map(MaybeUninit::new);
                } else {
                    for (out, value) in out.iter_mut().zip(millimetres) {
                        out.write(value);
                    }
                }
            }
        }
        super::simd::assume_written(depth_mm)
    }
}

/// Depth in millimetres, rounded, at most [`DEPTH_MAX_MM`]; 0 for an inverse depth of 0.
fn millimetres(inverse_m: f32) -> u16 {
    // Below 2²³, adding 2²³ leaves the rounded integer in the lowest bits of the mantissa.
    const ROUND: f32 = 8_388_608.0;
    let depth = (1000.0 / inverse_m).min(f32::from(DEPTH_MAX_MM));
    let bits = (depth + ROUND).to_bits() as u16;
    if inverse_m > 0.0 { bits } else { 0 }
}

/// Index of the first pixel whose centre lies at or beyond `position`, limited to 0..=side.
fn first_centre(position: f32, side: usize) -> usize {
    (position - 0.5).ceil().clamp(0.0, side as f32) as usize
}

/// Notes where an edge crosses each row of pixel centres; `upper` is its end with the smaller y.
fn edge(upper: Corner, lower: Corner, limit: f32, crossing: &mut [i32]) {
    let (first, end) = (first_centre(upper.y_px, crossing.len()), first_centre(lower.y_px, crossing.len()));
    if first >= end {
        return;
    }
    let slope = (lower.x_px - upper.x_px) / (lower.y_px - upper.y_px);
    for (offset, crossing) in crossing[first..end].iter_mut().enumerate() {
        let y = (first + offset) as f32 + 0.5;
        let x = upper.x_px + (y - upper.y_px) * slope;
        *crossing = (x - 0.5).ceil().clamp(0.0, limit) as i32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const FLAT: Plane = Plane { at_origin: 0.5, per_x: 0.0, per_y: 0.0 };

    fn corner(x_px: f32, y_px: f32) -> Corner {
        Corner { x_px, y_px, inverse_m: 0.5 }
    }

    fn image(raster: &mut Raster) -> Vec<u16> {
        let mut frame = vec![MaybeUninit::uninit(); raster.side() * raster.side()];
        raster.finish(&mut frame).to_vec()
    }

    #[test]
    fn a_rectangle_covers_the_centres_inside_it() {
        let mut raster = Raster::new(12);
        raster.fill(&[corner(2.5, 3.0), corner(10.5, 3.0), corner(10.5, 4.5), corner(2.5, 4.5)], FLAT);
        let image = image(&mut raster);
        for y in 0..12 {
            for x in 0..12 {
                let expected = if y == 3 && (2..10).contains(&x) { 2000 } else { 0 };
                assert_eq!(image[y * 12 + x], expected, "({x}, {y})");
            }
        }
        assert!(self::image(&mut raster).iter().all(|&depth| depth == 0), "cleared");
    }

    #[test]
    fn depth_is_rounded_and_limited() {
        assert_eq!(millimetres(0.0), 0);
        assert_eq!(millimetres(1.0), 1000);
        assert_eq!(millimetres(1.0 / 1.2344), 1234);
        assert_eq!(millimetres(1.0 / 1.2346), 1235);
        assert_eq!(millimetres(1e-9), DEPTH_MAX_MM);
    }

    proptest! {
        /// The image cut into triangles around any point: each pixel is covered, and exactly once.
        #[test]
        fn neighbours_share_no_pixel_and_leave_none(cx in 0f32..20.0, cy in 0f32..20.0,
                                                    along in prop::collection::vec(0.01f32..0.99, 1..5)) {
            let side = 20.0;
            let mut rim = vec![];
            let edges = [((0.0, 0.0), (side, 0.0)), ((side, 0.0), (side, side)), ((side, side), (0.0, side)),
                         ((0.0, side), (0.0, 0.0))];
            let mut along = along;
            along.sort_by(f32::total_cmp);
            for ((ax, ay), (bx, by)) in edges {
                rim.push(corner(ax, ay));
                rim.extend(along.iter().map(|t| corner(ax + t * (bx - ax), ay + t * (by - ay))));
            }
            let mut count = vec![0; 400];
            for i in 0..rim.len() {
                let mut raster = Raster::new(20);
                raster.fill(&[corner(cx, cy), rim[i], rim[(i + 1) % rim.len()]], FLAT);
                for (count, depth) in count.iter_mut().zip(image(&mut raster)) {
                    *count += i32::from(depth > 0);
                }
            }
            prop_assert!(count.iter().all(|&n| n == 1), "{count:?}");
        }
    }
}
