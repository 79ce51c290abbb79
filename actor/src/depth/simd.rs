//! The unsafe code of the depth camera: eight pixels at once, and memory that is not initialised yet.

use std::mem::MaybeUninit;

/// A row of a polygon.
#[derive(Debug, Clone, Copy)]
pub struct Span {
    /// Its first pixel, and the one after its last.
    pub pixels: [f32; 2],
    /// Inverse depth at x = 0 in this row, and its change per pixel.
    pub at_zero: f32,
    pub per_x: f32,
    /// Least and greatest inverse depth of the polygon.
    pub limits: [f32; 2],
}

/// Raises groups of eight pixels, the first of which begins at pixel `start`, to the span's inverse depth.
#[cfg(target_feature = "avx")]
pub fn raise(groups: &mut [[f32; 8]], start: f32, span: Span) {
    use std::arch::x86_64::{
        _CMP_GT_OQ, _CMP_LT_OQ, _mm256_add_ps, _mm256_and_ps, _mm256_cmp_ps, _mm256_loadu_ps, _mm256_max_ps,
        _mm256_min_ps, _mm256_mul_ps, _mm256_set1_ps, _mm256_setr_ps, _mm256_storeu_ps,
    };
    // SAFETY: the instructions exist, the build's target has AVX; each load and store covers one `[f32; 8]`.
    unsafe {
        let centres = _mm256_setr_ps(0.5, 1.5, 2.5, 3.5, 4.5, 5.5, 6.5, 7.5);
        let mut x = _mm256_add_ps(_mm256_set1_ps(start), centres);
        let (from, to) = (_mm256_set1_ps(span.pixels[0]), _mm256_set1_ps(span.pixels[1]));
        let (at_zero, per_x) = (_mm256_set1_ps(span.at_zero), _mm256_set1_ps(span.per_x));
        let (least, greatest) = (_mm256_set1_ps(span.limits[0]), _mm256_set1_ps(span.limits[1]));
        for group in groups {
            let inverse = _mm256_add_ps(at_zero, _mm256_mul_ps(per_x, x));
            let inverse = _mm256_max_ps(_mm256_min_ps(inverse, greatest), least);
            let inside = _mm256_and_ps(_mm256_cmp_ps::<_CMP_GT_OQ>(x, from), _mm256_cmp_ps::<_CMP_LT_OQ>(x, to));
            let before = _mm256_loadu_ps(group.as_ptr());
            _mm256_storeu_ps(group.as_mut_ptr(), _mm256_max_ps(before, _mm256_and_ps(inverse, inside)));
            x = _mm256_add_ps(x, _mm256_set1_ps(8.0));
        }
    }
}

/// The same, bit for bit, without vector instructions.
#[cfg(any(test, not(target_feature = "avx")))]
#[cfg_attr(target_feature = "avx", allow(dead_code))]
pub fn raise_plain(groups: &mut [[f32; 8]], start: f32, span: Span) {
    let [from, to] = span.pixels;
    let [least, greatest] = span.limits;
    for (i, pixel) in groups.as_flattened_mut().iter_mut().enumerate() {
        let x = start + (i as f32 + 0.5);
        let inverse = span.at_zero + span.per_x * x;
        let inverse = if inverse < greatest { inverse } else { greatest };
        let inverse = if inverse > least { inverse } else { least };
        if x > from && x < to && inverse > *pixel {
            *pixel = inverse;
        }
    }
}

#[cfg(not(target_feature = "avx"))]
pub use raise_plain as raise;

/// Declares a frame written. The caller has written every element: it is `Raster::finish`, whose loops cover rows
/// and columns without remainder.
pub fn assume_written(frame: &mut [MaybeUninit<u16>]) -> &[u16] {
    // SAFETY: MaybeUninit<u16> has the layout of u16, and every element was written.
    unsafe { &*(std::ptr::from_mut(frame) as *const [u16]) }
}

/// Written memory as memory that need not be.
pub fn as_unwritten(frame: &mut [u16]) -> &mut [MaybeUninit<u16>] {
    // SAFETY: MaybeUninit<u16> has the layout of u16. This module's callers only write initialised values to it.
    unsafe { &mut *(std::ptr::from_mut(frame) as *mut [MaybeUninit<u16>]) }
}

#[cfg(all(test, target_feature = "avx"))]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn vector_and_plain_code_give_the_same_bits(start in 0u8..200, from in 0u8..40, length in 0u8..40,
                at_zero in -1f32..5.0, per_x in -0.1f32..0.1, low in 0f32..2.0, high in 2f32..4.0,
                before in prop::array::uniform8(0f32..4.0)) {
            let (start, from) = (f32::from(start), f32::from(start) + f32::from(from));
            let span = Span { pixels: [from, from + f32::from(length)], at_zero, per_x, limits: [low, high] };
            let (mut a, mut b) = ([before; 5], [before; 5]);
            raise(&mut a, start, span);
            raise_plain(&mut b, start, span);
            prop_assert_eq!(a.map(|group| group.map(f32::to_bits)), b.map(|group| group.map(f32::to_bits)));
        }
    }
}
