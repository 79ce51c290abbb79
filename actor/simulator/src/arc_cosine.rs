//! The C library's `acosf`, with the same bits under every C library.
//!
//! The physics' dependencies call `f32::acos`, which is that function. Since version 2.41 glibc rounds it correctly; before,
//! and here, it is fdlibm's (Sun Microsystems 1993, `e_acosf.c`), whose last bit differs. The linker takes this definition
//! in place of the library's in all programs, and in the Python module, which is linked with `-Bsymbolic-functions`.

const PI_HALF_HIGH: f32 = f32::from_bits(0x3fc9_0fda);
const PI_HALF_LOW: f32 = f32::from_bits(0x33a2_2168);
const PI: f32 = f32::from_bits(0x4049_0fda);
/// (asin(√z)/√z − 1) / z is the quotient of two polynomials; from the highest power down.
const NUMERATOR: [f32; 6] = [3.479_331e-5, 7.915_35e-4, -0.040_055_536, 0.201_212_53, -0.325_565_82, 0.166_666_67];
const DENOMINATOR: [f32; 5] = [0.077_038_154, -0.688_284, 2.020_945_8, -2.403_395, 1.0];

#[unsafe(no_mangle)]
extern "C" fn acosf(x: f32) -> f32 {
    let horner = |coefficients: &[f32], z: f32| coefficients.iter().fold(0.0, |sum, one| one + z * sum);
    let quotient = |z: f32| z * horner(&NUMERATOR, z) / horner(&DENOMINATOR, z);
    let size = x.abs();
    if size > 1.0 || x.is_nan() {
        f32::NAN
    } else if size == 1.0 {
        if x > 0.0 { 0.0 } else { PI + 2.0 * PI_HALF_LOW }
    } else if size < 0.5 {
        if size.to_bits() <= 0x3280_0000 {
            return PI_HALF_HIGH + PI_HALF_LOW;
        }
        PI_HALF_HIGH - (x - (PI_HALF_LOW - x * quotient(x * x)))
    } else if x < 0.0 {
        let z = (1.0 + x) * 0.5;
        let root = z.sqrt();
        let rest = quotient(z) * root - PI_HALF_LOW;
        PI - 2.0 * (root + rest)
    } else {
        let z = (1.0 - x) * 0.5;
        let root = z.sqrt();
        // Half of its bits, so that its square is exact.
        let high = f32::from_bits(root.to_bits() & 0xffff_f000);
        let low = (z - high * high) / (root + high);
        2.0 * (high + (quotient(z) * root + low))
    }
}

#[cfg(test)]
mod tests {
    use super::acosf;

    /// FNV-1a over the bits of what `acosf` of glibc 2.36 gives, called by a program in C.
    const OF_GLIBC_2_36: u64 = 0xdf9f_db87_79f6_2ed8;

    #[test]
    fn it_has_the_bits_of_glibc_before_2_41_and_is_what_programs_call() {
        let mut hash = 0xcbf2_9ce4_8422_2325_u64;
        for bits in (0..=1.0f32.to_bits()).step_by(997).flat_map(|bits| [bits, bits | 1 << 31]) {
            let x = f32::from_bits(bits);
            assert_eq!(std::hint::black_box(x).acos().to_bits(), acosf(x).to_bits(), "{x:e}");
            hash = (hash ^ u64::from(acosf(x).to_bits())).wrapping_mul(0x100_0000_01b3);
        }
        assert_eq!(hash, OF_GLIBC_2_36);
        assert_eq!([acosf(1.0), acosf(-1.0)], [0.0, std::f32::consts::PI]);
        assert!(acosf(1.5).is_nan() && acosf(f32::NAN).is_nan());
    }
}
