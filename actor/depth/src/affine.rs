//! What is affine over the image, as inverse depth is over that of a plane.

use std::ops::{Add, Mul, Sub};

/// Something affine over the image: `at_origin + per_x · x + per_y · y`, pixels from the top left.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Affine {
    pub at_origin: f64,
    pub per_x: f64,
    pub per_y: f64,
}

impl Add for Affine {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self {
            at_origin: self.at_origin + other.at_origin,
            per_x: self.per_x + other.per_x,
            per_y: self.per_y + other.per_y,
        }
    }
}

impl Mul<f64> for Affine {
    type Output = Self;
    fn mul(self, k: f64) -> Self {
        Self { at_origin: self.at_origin * k, per_x: self.per_x * k, per_y: self.per_y * k }
    }
}

impl Sub for Affine {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self + other * -1.0
    }
}

impl Affine {
    /// The same about another origin.
    pub fn about(self, [x, y]: [f64; 2]) -> Self {
        Self { at_origin: self.at_origin + self.per_x * x + self.per_y * y, ..self }
    }

    /// Factors of 1, x, y, x², xy, y² in a product.
    pub fn times(self, other: Self) -> [f64; 6] {
        let (a, b) = (self, other);
        [
            a.at_origin * b.at_origin,
            a.at_origin * b.per_x + a.per_x * b.at_origin,
            a.at_origin * b.per_y + a.per_y * b.at_origin,
            a.per_x * b.per_x,
            a.per_x * b.per_y + a.per_y * b.per_x,
            a.per_y * b.per_y,
        ]
    }
}
