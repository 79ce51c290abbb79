//! The unsafe code of depth cameras, also of the simulator's: eight numbers at once.
//!
//! [`Lanes`] has one meaning and three builds: with AVX2, with NEON, and plain. Every operation is one that IEEE 754
//! rounds exactly, nothing is fused and nothing approximated, so all builds give the same bits on every machine.

// A number that nobody takes is seen without it.
#![allow(clippy::return_self_not_must_use)]

use std::ops::{Add, Div, Mul, Sub};

/// Numbers that are worked on at once.
pub const LANES: usize = 8;

#[cfg(target_feature = "avx2")]
mod vector {
    use std::arch::x86_64 as x86;

    #[derive(Debug, Clone, Copy)]
    pub struct Lanes(x86::__m256);

    #[derive(Debug, Clone, Copy)]
    pub struct Mask(x86::__m256);

    // SAFETY of every block below: the instructions exist, the build's target has AVX2; each load and store covers one
    // array of eight.
    impl Lanes {
        #[inline(always)]
        pub fn splat(value: f32) -> Self {
            // SAFETY: see above.
            Self(unsafe { x86::_mm256_set1_ps(value) })
        }

        #[inline(always)]
        pub fn load(from: &[f32; 8]) -> Self {
            // SAFETY: see above.
            Self(unsafe { x86::_mm256_loadu_ps(from.as_ptr()) })
        }

        #[inline(always)]
        pub fn store(self, to: &mut [f32; 8]) {
            // SAFETY: see above.
            unsafe { x86::_mm256_storeu_ps(to.as_mut_ptr(), self.0) }
        }

        /// The smaller; `other` where one is not a number.
        #[inline(always)]
        pub fn min(self, other: Self) -> Self {
            // SAFETY: see above.
            Self(unsafe { x86::_mm256_min_ps(self.0, other.0) })
        }

        /// The larger; `other` where one is not a number.
        #[inline(always)]
        pub fn max(self, other: Self) -> Self {
            // SAFETY: see above.
            Self(unsafe { x86::_mm256_max_ps(self.0, other.0) })
        }

        #[inline(always)]
        pub fn sqrt(self) -> Self {
            // SAFETY: see above.
            Self(unsafe { x86::_mm256_sqrt_ps(self.0) })
        }

        #[inline(always)]
        pub fn ceil(self) -> Self {
            // SAFETY: see above.
            Self(unsafe { x86::_mm256_ceil_ps(self.0) })
        }

        #[inline(always)]
        pub fn less(self, other: Self) -> Mask {
            // SAFETY: see above.
            Mask(unsafe { x86::_mm256_cmp_ps::<{ x86::_CMP_LT_OQ }>(self.0, other.0) })
        }

        /// These numbers where the mask is true, 0 elsewhere.
        #[inline(always)]
        pub fn only(self, mask: Mask) -> Self {
            // SAFETY: see above.
            Self(unsafe { x86::_mm256_and_ps(self.0, mask.0) })
        }

        /// These numbers where the mask is true, `other` elsewhere.
        #[inline(always)]
        pub fn or_else(self, mask: Mask, other: Self) -> Self {
            // SAFETY: see above.
            Self(unsafe { x86::_mm256_blendv_ps(other.0, self.0, mask.0) })
        }

        /// Lane i of the result is lane `from[i]` of these, 0..8.
        #[inline(always)]
        pub fn pick(self, from: &[i32; 8]) -> Self {
            // SAFETY: see above.
            Self(unsafe {
                let from = x86::_mm256_loadu_si256(from.as_ptr().cast());
                x86::_mm256_permutevar8x32_ps(self.0, from)
            })
        }

        /// Whole numbers in 0..65536, or not a number, which becomes anything, as 16 bits.
        #[inline(always)]
        pub fn to_u16(self) -> [u16; 8] {
            let mut out = [0u16; 8];
            // SAFETY: see above; the store covers the 16 bytes of `out`.
            unsafe {
                let whole = x86::_mm256_cvttps_epi32(self.0);
                let (low, high) = (x86::_mm256_castsi256_si128(whole), x86::_mm256_extracti128_si256::<1>(whole));
                x86::_mm_storeu_si128(out.as_mut_ptr().cast(), x86::_mm_packus_epi32(low, high));
            }
            out
        }
    }

    impl Mask {
        #[inline(always)]
        pub fn and(self, other: Self) -> Self {
            // SAFETY: see above.
            Self(unsafe { x86::_mm256_and_ps(self.0, other.0) })
        }

        /// Bit i is lane i.
        #[inline(always)]
        pub fn bits(self) -> u32 {
            // SAFETY: see above.
            (unsafe { x86::_mm256_movemask_ps(self.0) }).cast_unsigned()
        }
    }

    macro_rules! operator {
        ($name:ident, $function:ident, $instruction:ident) => {
            impl super::$name for Lanes {
                type Output = Self;
                #[inline(always)]
                fn $function(self, other: Self) -> Self {
                    // SAFETY: see above.
                    Self(unsafe { x86::$instruction(self.0, other.0) })
                }
            }
        };
    }
    operator!(Add, add, _mm256_add_ps);
    operator!(Sub, sub, _mm256_sub_ps);
    operator!(Mul, mul, _mm256_mul_ps);
    operator!(Div, div, _mm256_div_ps);
}

#[cfg(target_arch = "aarch64")]
mod vector {
    use std::arch::aarch64 as arm;

    #[derive(Debug, Clone, Copy)]
    pub struct Lanes([arm::float32x4_t; 2]);

    #[derive(Debug, Clone, Copy)]
    pub struct Mask([arm::uint32x4_t; 2]);

    // SAFETY of every block below: every 64-bit ARM processor has NEON; each load and store covers one array of eight.
    macro_rules! halves {
        ($instruction:ident, $($whole:expr),+) => {
            // SAFETY: see above.
            unsafe { [arm::$instruction($($whole.0[0]),+), arm::$instruction($($whole.0[1]),+)] }
        };
    }

    impl Lanes {
        #[inline(always)]
        pub fn splat(value: f32) -> Self {
            // SAFETY: see above.
            Self([unsafe { arm::vdupq_n_f32(value) }; 2])
        }

        #[inline(always)]
        pub fn load(from: &[f32; 8]) -> Self {
            // SAFETY: see above.
            let halves = unsafe { arm::vld1q_f32_x2(from.as_ptr()) };
            Self([halves.0, halves.1])
        }

        #[inline(always)]
        pub fn store(self, to: &mut [f32; 8]) {
            // SAFETY: see above.
            unsafe { arm::vst1q_f32_x2(to.as_mut_ptr(), arm::float32x4x2_t(self.0[0], self.0[1])) }
        }

        /// The smaller; `other` where one is not a number: NEON's own instruction answers otherwise.
        #[inline(always)]
        pub fn min(self, other: Self) -> Self {
            self.or_else(self.less(other), other)
        }

        /// The larger; `other` where one is not a number.
        #[inline(always)]
        pub fn max(self, other: Self) -> Self {
            self.or_else(other.less(self), other)
        }

        #[inline(always)]
        pub fn sqrt(self) -> Self {
            Self(halves!(vsqrtq_f32, self))
        }

        #[inline(always)]
        pub fn ceil(self) -> Self {
            Self(halves!(vrndpq_f32, self))
        }

        #[inline(always)]
        pub fn less(self, other: Self) -> Mask {
            Mask(halves!(vcltq_f32, self, other))
        }

        /// These numbers where the mask is true, 0 elsewhere.
        #[inline(always)]
        pub fn only(self, mask: Mask) -> Self {
            self.or_else(mask, Self::splat(0.0))
        }

        /// These numbers where the mask is true, `other` elsewhere.
        #[inline(always)]
        pub fn or_else(self, mask: Mask, other: Self) -> Self {
            Self(halves!(vbslq_f32, mask, self, other))
        }

        /// Lane i of the result is lane `from[i]` of these, 0..8.
        #[inline(always)]
        pub fn pick(self, from: &[i32; 8]) -> Self {
            let numbers = self.to_array();
            Self::load(&from.map(|from| numbers[from as usize]))
        }

        /// Whole numbers in 0..65536, or not a number, which becomes anything, as 16 bits.
        #[inline(always)]
        pub fn to_u16(self) -> [u16; 8] {
            let mut out = [0u16; 8];
            // SAFETY: see above; the store covers the 16 bytes of `out`.
            unsafe {
                let [low, high] = self.0.map(|half| arm::vmovn_u32(arm::vcvtq_u32_f32(half)));
                arm::vst1q_u16(out.as_mut_ptr(), arm::vcombine_u16(low, high));
            }
            out
        }
    }

    impl Mask {
        #[inline(always)]
        pub fn and(self, other: Self) -> Self {
            Self(halves!(vandq_u32, self, other))
        }

        /// Bit i is lane i.
        #[inline(always)]
        pub fn bits(self) -> u32 {
            let place: [u32; 8] = [1, 2, 4, 8, 16, 32, 64, 128];
            // SAFETY: see above.
            unsafe {
                let low = arm::vandq_u32(self.0[0], arm::vld1q_u32(place.as_ptr()));
                let high = arm::vandq_u32(self.0[1], arm::vld1q_u32(place[4..].as_ptr()));
                arm::vaddvq_u32(arm::vorrq_u32(low, high))
            }
        }
    }

    macro_rules! operator {
        ($name:ident, $function:ident, $instruction:ident) => {
            impl super::$name for Lanes {
                type Output = Self;
                #[inline(always)]
                fn $function(self, other: Self) -> Self {
                    Self(halves!($instruction, self, other))
                }
            }
        };
    }
    operator!(Add, add, vaddq_f32);
    operator!(Sub, sub, vsubq_f32);
    operator!(Mul, mul, vmulq_f32);
    operator!(Div, div, vdivq_f32);
}

#[cfg(any(test, not(any(target_feature = "avx2", target_arch = "aarch64"))))]
#[cfg_attr(any(target_feature = "avx2", target_arch = "aarch64"), allow(dead_code))]
mod plain {
    #[derive(Debug, Clone, Copy)]
    pub struct Lanes([f32; 8]);

    #[derive(Debug, Clone, Copy)]
    pub struct Mask([bool; 8]);

    impl Lanes {
        #[inline]
        pub fn splat(value: f32) -> Self {
            Self([value; 8])
        }

        #[inline]
        pub fn load(from: &[f32; 8]) -> Self {
            Self(*from)
        }

        #[inline]
        pub fn store(self, to: &mut [f32; 8]) {
            *to = self.0;
        }

        #[inline]
        fn with(self, other: Self, f: impl Fn(f32, f32) -> f32) -> Self {
            Self(std::array::from_fn(|i| f(self.0[i], other.0[i])))
        }

        /// The smaller; `other` where one is not a number.
        #[inline]
        pub fn min(self, other: Self) -> Self {
            self.with(other, |a, b| if a < b { a } else { b })
        }

        /// The larger; `other` where one is not a number.
        #[inline]
        pub fn max(self, other: Self) -> Self {
            self.with(other, |a, b| if a > b { a } else { b })
        }

        #[inline]
        pub fn sqrt(self) -> Self {
            Self(self.0.map(f32::sqrt))
        }

        #[inline]
        pub fn ceil(self) -> Self {
            Self(self.0.map(f32::ceil))
        }

        #[inline]
        pub fn less(self, other: Self) -> Mask {
            Mask(std::array::from_fn(|i| self.0[i] < other.0[i]))
        }

        /// These numbers where the mask is true, 0 elsewhere.
        #[inline]
        pub fn only(self, mask: Mask) -> Self {
            Self(std::array::from_fn(|i| if mask.0[i] { self.0[i] } else { 0.0 }))
        }

        /// These numbers where the mask is true, `other` elsewhere.
        #[inline]
        pub fn or_else(self, mask: Mask, other: Self) -> Self {
            Self(std::array::from_fn(|i| if mask.0[i] { self.0[i] } else { other.0[i] }))
        }

        /// Lane i of the result is lane `from[i]` of these, 0..8.
        #[inline]
        pub fn pick(self, from: &[i32; 8]) -> Self {
            Self(from.map(|from| self.0[from as usize]))
        }

        /// Whole numbers in 0..65536, or not a number, which becomes anything, as 16 bits.
        #[inline]
        pub fn to_u16(self) -> [u16; 8] {
            self.0.map(|value| value as u16)
        }
    }

    impl Mask {
        #[inline]
        pub fn and(self, other: Self) -> Self {
            Self(std::array::from_fn(|i| self.0[i] && other.0[i]))
        }

        /// Bit i is lane i.
        #[inline]
        pub fn bits(self) -> u32 {
            self.0.iter().enumerate().map(|(i, &truth)| u32::from(truth) << i).sum()
        }
    }

    macro_rules! operator {
        ($name:ident, $function:ident, $operator:tt) => {
            impl super::$name for Lanes {
                type Output = Self;
                #[inline]
                fn $function(self, other: Self) -> Self {
                    self.with(other, |a, b| a $operator b)
                }
            }
        };
    }
    operator!(Add, add, +);
    operator!(Sub, sub, -);
    operator!(Mul, mul, *);
    operator!(Div, div, /);
}

#[cfg(not(any(target_feature = "avx2", target_arch = "aarch64")))]
pub use plain::{Lanes, Mask};
#[cfg(any(target_feature = "avx2", target_arch = "aarch64"))]
pub use vector::{Lanes, Mask};

impl Lanes {
    /// 0, 1, 2, ... 7.
    #[inline(always)]
    pub fn ramp() -> Self {
        Self::load(&[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0])
    }

    #[inline(always)]
    pub fn to_array(self) -> [f32; 8] {
        let mut out = [0.0; 8];
        self.store(&mut out);
        out
    }

    /// The largest of the eight; none of them may be NaN.
    #[inline(always)]
    pub fn largest(self) -> f32 {
        let a = self.max(self.pick(&[4, 5, 6, 7, 0, 1, 2, 3]));
        let a = a.max(a.pick(&[2, 3, 0, 1, 6, 7, 4, 5]));
        a.max(a.pick(&[1, 0, 3, 2, 5, 4, 7, 6])).to_array()[0]
    }

    /// The smallest of the eight; none of them may be NaN.
    #[inline(always)]
    pub fn smallest(self) -> f32 {
        let a = self.min(self.pick(&[4, 5, 6, 7, 0, 1, 2, 3]));
        let a = a.min(a.pick(&[2, 3, 0, 1, 6, 7, 4, 5]));
        a.min(a.pick(&[1, 0, 3, 2, 5, 4, 7, 6])).to_array()[0]
    }
}

#[cfg(all(test, any(target_feature = "avx2", target_arch = "aarch64")))]
mod tests {
    use super::{plain, vector};
    use proptest::prelude::*;

    fn bits(numbers: [f32; 8]) -> [u32; 8] {
        // Which NaN it is does not matter: none is ever stored.
        numbers.map(|number| if number.is_nan() { f32::NAN.to_bits() } else { number.to_bits() })
    }

    proptest! {
        #[test]
        fn vector_and_plain_code_give_the_same_bits(a in prop::array::uniform8(-9f32..9.0),
                b in prop::array::uniform8(prop_oneof![-9f32..9.0, Just(0.0), Just(f32::INFINITY)]),
                from in prop::array::uniform8(0i32..8)) {
            let (va, vb) = (vector::Lanes::load(&a), vector::Lanes::load(&b));
            let (pa, pb) = (plain::Lanes::load(&a), plain::Lanes::load(&b));
            let same = |v: vector::Lanes, p: plain::Lanes| {
                let (mut x, mut y) = ([0.0; 8], [0.0; 8]);
                v.store(&mut x);
                p.store(&mut y);
                bits(x) == bits(y)
            };
            prop_assert!(same(va + vb, pa + pb));
            prop_assert!(same(va - vb, pa - pb));
            prop_assert!(same(va * vb, pa * pb));
            prop_assert!(same(va / vb, pa / pb));
            prop_assert!(same(va.min(vb), pa.min(pb)));
            prop_assert!(same(va.max(vb), pa.max(pb)));
            prop_assert!(same(va.sqrt(), pa.sqrt()));
            prop_assert!(same(va.ceil(), pa.ceil()));
            prop_assert!(same(va.pick(&from), pa.pick(&from)));
            prop_assert!(same(va.only(va.less(vb)), pa.only(pa.less(pb))));
            prop_assert!(same(va.or_else(va.less(vb), vb), pa.or_else(pa.less(pb), pb)));
            let (zero, nine) = (vector::Lanes::splat(0.0), vector::Lanes::splat(9.0));
            prop_assert_eq!(va.less(vb).and(zero.less(va)).bits(),
                            pa.less(pb).and(plain::Lanes::splat(0.0).less(pa)).bits());
            let whole = (va + nine).ceil();
            let mut numbers = [0.0; 8];
            whole.store(&mut numbers);
            prop_assert_eq!(whole.to_u16(), plain::Lanes::load(&numbers).to_u16());
        }
    }
}
