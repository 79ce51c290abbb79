//! Which pixel's centre comes first at or beyond a position along a row or a column.

use depth::simd::Lanes;

/// First pixel whose centre lies at or beyond each position, limited to 0..=limit.
#[inline(always)]
pub fn first_centres(position: Lanes, limit: f32) -> Lanes {
    (position - Lanes::splat(0.5)).ceil().max(Lanes::splat(0.0)).min(Lanes::splat(limit))
}

/// Index of the first pixel whose centre lies at or beyond `position`, limited to 0..=limit.
pub fn first_centre(position: f32, limit: f32) -> f32 {
    least(most((position - 0.5).ceil(), 0.0), limit)
}

/// The smaller of two numbers: unlike `f32::min` one instruction, because neither is NaN.
pub fn least(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// The larger of two numbers, neither of them NaN.
pub fn most(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}
