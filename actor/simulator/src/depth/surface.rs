//! What is drawn within an outline: inverse depth over the image of a convex solid's visible side.
//!
//! A ray enters a convex solid where it has entered all of its half-spaces: the entry is the *farthest* of the entries
//! through its front faces, so the solid's inverse depth is the least of those of its faces' planes. Within the outline
//! nothing else needs to be known, neither which pixel shows which face nor the edges between them. The same holds
//! for a cylinder: its entry is the farther of its mantle's and its cap's.

use depth::simd::{LANES, Lanes};

/// Inverse depth over a region of the image, a row at a time.
pub trait Surface {
    /// Goes to the row whose pixels' centres have this y, pixels from the top.
    fn begin_row(&mut self, y_px: f32);

    /// Inverse depths at these x, pixels from the left, in that row.
    fn inverse_m(&self, x_px: Lanes) -> Lanes;
}

/// Something that is affine over the image: `at_origin + per_x · x + per_y · y`, with x and y in pixels from the top
/// left of the image. Inverse depth is affine over the image of a plane.
#[derive(Debug, Clone, Copy, Default)]
pub struct Plane {
    pub at_origin: f32,
    pub per_x: f32,
    pub per_y: f32,
}

impl Plane {
    fn in_row(self, y_px: f32) -> [f32; 2] {
        [self.at_origin + self.per_y * y_px, self.per_x]
    }
}

#[inline(always)]
fn along([at_zero, per_x]: [f32; 2], x_px: Lanes) -> Lanes {
    Lanes::splat(at_zero) + Lanes::splat(per_x) * x_px
}

#[derive(Debug)]
pub struct Planes<const N: usize> {
    planes: [Plane; N],
    in_row: [[f32; 2]; N],
}

impl<const N: usize> Planes<N> {
    /// The least of these, at least one.
    #[inline(always)]
    pub fn new(planes: [Plane; N]) -> Self {
        Self { planes, in_row: [[0.0; 2]; N] }
    }
}

impl<const N: usize> Surface for Planes<N> {
    #[inline(always)]
    fn begin_row(&mut self, y_px: f32) {
        self.in_row = self.planes.map(|plane| plane.in_row(y_px));
    }

    #[inline(always)]
    fn inverse_m(&self, x_px: Lanes) -> Lanes {
        let first = along(self.in_row[0], x_px);
        self.in_row[1..].iter().fold(first, |least, &row| least.min(along(row, x_px)))
    }
}

/// Many planes, [`LANES`] a block; what is left of the last block repeats one of them.
#[derive(Debug, Clone, Default)]
pub struct ManyPlanes {
    count: usize,
    blocks: Vec<Block>,
    in_row: Vec<[f32; LANES]>,
}

#[derive(Debug, Clone, Copy, Default)]
struct Block {
    at_origin: [f32; LANES],
    per_x: [f32; LANES],
    per_y: [f32; LANES],
}

impl ManyPlanes {
    pub fn clear(&mut self) {
        self.count = 0;
        self.blocks.clear();
    }

    #[inline(always)]
    pub fn push(&mut self, plane: Plane) {
        let lane = self.count % LANES;
        if lane == 0 {
            let repeat = |value| [value; LANES];
            self.blocks.push(Block {
                at_origin: repeat(plane.at_origin),
                per_x: repeat(plane.per_x),
                per_y: repeat(plane.per_y),
            });
        } else if let Some(block) = self.blocks.last_mut() {
            block.at_origin[lane] = plane.at_origin;
            block.per_x[lane] = plane.per_x;
            block.per_y[lane] = plane.per_y;
        }
        self.count += 1;
    }

    pub fn len(&self) -> usize {
        self.count
    }

    pub fn get(&self, index: usize) -> Plane {
        let block = &self.blocks[index / LANES];
        let lane = index % LANES;
        Plane { at_origin: block.at_origin[lane], per_x: block.per_x[lane], per_y: block.per_y[lane] }
    }

    pub fn first<const N: usize>(&self) -> [Plane; N] {
        std::array::from_fn(|i| self.get(i))
    }
}

impl Surface for ManyPlanes {
    #[inline(always)]
    fn begin_row(&mut self, y_px: f32) {
        let y_px = Lanes::splat(y_px);
        self.in_row.clear();
        self.in_row.extend(
            self.blocks
                .iter()
                .map(|block| (Lanes::load(&block.at_origin) + Lanes::load(&block.per_y) * y_px).to_array()),
        );
    }

    #[inline(always)]
    fn inverse_m(&self, x_px: Lanes) -> Lanes {
        let mut least = [Lanes::splat(f32::MAX); 2];
        for (block, in_row) in self.blocks.iter().zip(&self.in_row) {
            for lane in 0..LANES {
                let value = along([in_row[lane], block.per_x[lane]], x_px);
                least[lane % 2] = least[lane % 2].min(value);
            }
        }
        least[0].min(least[1])
    }
}

/// The mantle of a cylinder about any axis, and at most one cap.
///
/// With the axis A, the unit vector u from the axis to the eye at a right angle to it, v = A × u, ρ the eye's distance
/// from the axis and r the radius, a ray of direction d (z = 1) meets the mantle first at inverse depth
/// (√((r d·u)² − (ρ² − r²)(d·v)²) − ρ d·u) / (ρ² − r²): under the root stands a product of two affine functions.
#[derive(Debug)]
pub struct Mantle {
    pub outside: Plane,
    pub root: [Plane; 2],
    /// Infinitely near where there is no cap to be seen.
    pub cap: Plane,
    in_row: [[f32; 2]; 4],
}

impl Mantle {
    /// The mantle from the affine parts of its formula.
    #[inline(always)]
    pub fn new(outside: Plane, root: [Plane; 2], cap: Option<Plane>) -> Self {
        let cap = cap.unwrap_or(Plane { at_origin: f32::MAX, per_x: 0.0, per_y: 0.0 });
        Self { outside, root, cap, in_row: [[0.0; 2]; 4] }
    }
}

impl Surface for Mantle {
    #[inline(always)]
    fn begin_row(&mut self, y_px: f32) {
        self.in_row = [self.outside, self.root[0], self.root[1], self.cap].map(|plane| plane.in_row(y_px));
    }

    #[inline(always)]
    fn inverse_m(&self, x_px: Lanes) -> Lanes {
        let [outside, a, b, cap] = self.in_row;
        let root = (along(a, x_px) * along(b, x_px)).max(Lanes::splat(0.0)).sqrt();
        (along(outside, x_px) + root).min(along(cap, x_px))
    }
}

/// A sphere: inverse depth is an affine function plus the root of a quadratic one, which is positive just inside of
/// its silhouette.
#[derive(Debug)]
pub struct Ball {
    pub outside: Plane,
    /// Where the sphere's centre is seen, pixels; the quadratic function is given about it.
    pub centre_px: [f32; 2],
    /// Coefficients of 1, x, y, x², x·y, y².
    pub quadratic: [f32; 6],
    outside_in_row: [f32; 2],
    in_row: [f32; 3],
}

impl Ball {
    /// The sphere from the parts of its formula.
    #[inline(always)]
    pub fn new(outside: Plane, centre_px: [f32; 2], quadratic: [f32; 6]) -> Self {
        Self { outside, centre_px, quadratic, outside_in_row: [0.0; 2], in_row: [0.0; 3] }
    }

    /// The pixels of [`LANES`] rows, the first of which has its centres at `y_px`, in which the sphere is seen:
    /// from and to, pixels. From is not before to where it is not seen.
    #[inline(always)]
    pub fn interval(&self, y_px: f32) -> [Lanes; 2] {
        let y = Lanes::splat(y_px - self.centre_px[1]) + Lanes::ramp();
        let [one, x1, y1, xx, xy, yy] = self.quadratic.map(Lanes::splat);
        let at_centre = one + y * (y1 + y * yy);
        let per_x = x1 + y * xy;
        // Roots of a x² + b x + c, where a < 0.
        let discriminant = per_x * per_x - Lanes::splat(4.0) * xx * at_centre;
        let seen = Lanes::splat(0.0).less(discriminant);
        let root = discriminant.only(seen).sqrt();
        let scale = Lanes::splat(-0.5 / self.quadratic[3]);
        let x = Lanes::splat(self.centre_px[0]);
        [x + (per_x - root) * scale, (x + (per_x + root) * scale).or_else(seen, Lanes::splat(f32::MIN))]
    }
}

impl Surface for Ball {
    #[inline(always)]
    fn begin_row(&mut self, y_px: f32) {
        self.outside_in_row = self.outside.in_row(y_px);
        let y = y_px - self.centre_px[1];
        let [one, x1, y1, xx, xy, yy] = self.quadratic;
        self.in_row = [one + y * (y1 + y * yy), x1 + y * xy, xx];
    }

    #[inline(always)]
    fn inverse_m(&self, x_px: Lanes) -> Lanes {
        let x = x_px - Lanes::splat(self.centre_px[0]);
        let [one, x1, xx] = self.in_row.map(Lanes::splat);
        let root = (one + x * (x1 + x * xx)).max(Lanes::splat(0.0)).sqrt();
        along(self.outside_in_row, x_px) + root
    }
}
