//! Inverse depth over the image of a convex solid's visible side, a row at a time. It is 0 or less where a ray misses.
//!
//! A ray enters a convex solid where it has entered all of its half-spaces: the entry is the *farthest* of the entries
//! through the faces that look at the eye, so the solid's inverse depth is the least of theirs.

use crate::affine::Affine;
use crate::simd::Lanes;

/// Inverse depth over a region of the image.
pub(crate) trait Surface {
    /// Goes to the row whose pixels' centres have this y, pixels from the top.
    fn begin_row(&mut self, y_px: f32);

    /// Inverse depths at these x, pixels from the left, in that row.
    fn inverse_m(&self, x_px: Lanes) -> Lanes;
}

/// Something affine over the image, and its values in the row at hand.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Form {
    at_origin: f32,
    per_x: f32,
    per_y: f32,
    row: f32,
}

impl From<Affine> for Form {
    fn from(affine: Affine) -> Self {
        let Affine { at_origin, per_x, per_y } = affine;
        Self { at_origin: at_origin as f32, per_x: per_x as f32, per_y: per_y as f32, row: 0.0 }
    }
}

impl Form {
    #[inline(always)]
    fn begin_row(&mut self, y_px: f32) {
        self.row = self.at_origin + self.per_y * y_px;
    }

    #[inline(always)]
    fn at(&self, x_px: Lanes) -> Lanes {
        Lanes::splat(self.row) + Lanes::splat(self.per_x) * x_px
    }
}

/// The planes that look at the eye, between the depths of a solid's corners: the plane of a face seen edge-on is
/// ill-conditioned, its corners are not.
#[derive(Debug)]
pub(crate) struct Planes<const N: usize> {
    pub forms: [Form; N],
    pub least: f32,
    pub largest: f32,
}

impl<const N: usize> Surface for Planes<N> {
    #[inline(always)]
    fn begin_row(&mut self, y_px: f32) {
        self.forms.iter_mut().for_each(|form| form.begin_row(y_px));
    }

    #[inline(always)]
    fn inverse_m(&self, x_px: Lanes) -> Lanes {
        let mut least = Lanes::splat(self.largest);
        for form in &self.forms {
            least = least.min(form.at(x_px));
        }
        least.max(Lanes::splat(self.least))
    }
}

/// An ellipsoid: `outside + √square`, where `square` is a quadratic form about a pixel in its middle.
#[derive(Debug)]
pub(crate) struct Ellipsoid {
    pub outside: Form,
    pub middle_px: [f32; 2],
    /// Factors of 1, x, y, x², xy, y².
    pub square: [f32; 6],
    /// Factors of 1 and x in the row at hand.
    pub in_row: [f32; 2],
}

impl Ellipsoid {
    /// Where the square is not negative in the rows from `y_px` on: from left to right, pixels. All of the row where
    /// no bounds are known.
    #[inline(always)]
    pub fn interval(&self, y_px: f32) -> [Lanes; 2] {
        let [one, x, y, xx, xy, yy] = self.square.map(Lanes::splat);
        let y_px = Lanes::splat(y_px - self.middle_px[1]) + Lanes::ramp();
        let (one, x) = (one + y_px * (y + yy * y_px), x + xy * y_px);
        let discriminant = x * x - Lanes::splat(4.0) * xx * one;
        let infinite = Lanes::splat(f32::INFINITY);
        if self.square[3] >= 0.0 {
            return [Lanes::splat(0.0) - infinite, infinite];
        }
        let zero = Lanes::splat(0.0);
        let some = zero.less(discriminant);
        let half = Lanes::splat(-0.5) / xx;
        let centre = x * half + Lanes::splat(self.middle_px[0]);
        let reach = discriminant.max(zero).sqrt() * half;
        [(centre - reach).or_else(some, infinite), (centre + reach).or_else(some, zero - infinite)]
    }
}

impl Surface for Ellipsoid {
    #[inline(always)]
    fn begin_row(&mut self, y_px: f32) {
        self.outside.begin_row(y_px);
        let [one, x, y, _, xy, yy] = self.square;
        let y_px = y_px - self.middle_px[1];
        self.in_row = [one + y_px * (y + yy * y_px), x + xy * y_px];
    }

    #[inline(always)]
    fn inverse_m(&self, x_px: Lanes) -> Lanes {
        let [one, x] = self.in_row.map(Lanes::splat);
        let from_middle = x_px - Lanes::splat(self.middle_px[0]);
        let square = one + from_middle * (x + Lanes::splat(self.square[3]) * from_middle);
        let zero = Lanes::splat(0.0);
        (self.outside.at(x_px) + square.max(zero).sqrt()).only(zero.less(square))
    }
}

/// A cylinder: the ray enters its mantle and the slab between its caps, and leaves both.
#[derive(Debug)]
pub(crate) struct Cylinder {
    /// The mantle's inverse depths are `outside ± √(across² - beside²)`, where `across` has two parts.
    pub outside: Form,
    pub across: [Form; 2],
    pub beside: Form,
    /// The eye is outside of the mantle: the ray enters it.
    pub enters_mantle: bool,
    /// The cap that looks at the eye, if one does, and those that do not.
    pub enters: Option<Form>,
    pub leaves: [Form; 2],
}

impl Surface for Cylinder {
    #[inline(always)]
    fn begin_row(&mut self, y_px: f32) {
        let forms = self.across.iter_mut().chain(&mut self.leaves).chain(&mut self.enters);
        forms.for_each(|form| form.begin_row(y_px));
        self.outside.begin_row(y_px);
        self.beside.begin_row(y_px);
    }

    #[inline(always)]
    fn inverse_m(&self, x_px: Lanes) -> Lanes {
        let zero = Lanes::splat(0.0);
        let [a, b] = self.across.map(|form| form.at(x_px));
        let beside = self.beside.at(x_px);
        let square = a * a + b * b - beside * beside;
        let root = square.max(zero).sqrt();
        let outside = self.outside.at(x_px);
        let [c, d] = self.leaves.map(|form| form.at(x_px));
        let mut enters = Lanes::splat(f32::MAX);
        let mut leaves = c.max(d);
        if self.enters_mantle {
            enters = outside + root;
            leaves = leaves.max(outside - root);
        } else {
            leaves = leaves.max(outside + root);
        }
        if let Some(cap) = &self.enters {
            enters = enters.min(cap.at(x_px));
        }
        enters.only(zero.less(square).and(leaves.less(enters)))
    }
}
