//! Arithmetic that is the same on every x86-64 processor (`arithmetic.cpp`, `product.cpp`). On ARM its bits are others.
//!
//! A program that links this crate has it from its first operation on. `ATen`, oneDNN and MKL are held to one set of
//! kernels; products of matrices and square roots are our own.

use std::ffi::c_int;

unsafe extern "C" {
    fn stillroom_use_fastest();
    fn stillroom_reproducible() -> c_int;
}

/// Lets libtorch choose its kernels by the processor again. Must be called before the first computation.
pub fn use_fastest() {
    // SAFETY: it sets variables of the environment, before threads are started that could read them.
    unsafe { stillroom_use_fastest() }
}

/// Whether results are the same on every processor.
pub fn is_reproducible() -> bool {
    // SAFETY: it reads a variable.
    unsafe { stillroom_reproducible() != 0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::to_vec;
    use tch::{Device, Kind, Tensor};

    /// Terms of one chain of `product.cpp`.
    const DEPTH: usize = 256;

    /// Numbers in -1..1 of all sizes.
    fn numbers(count: usize, seed: u32) -> Vec<f32> {
        let mut state = seed.wrapping_mul(2654435761).wrapping_add(12345);
        (0..count)
            .map(|_| {
                state ^= state << 13;
                state ^= state >> 17;
                state ^= state << 5;
                (state as f32 / u32::MAX as f32 - 0.5) * (1 << (state % 5)) as f32 / 8.0
            })
            .collect()
    }

    /// The order of additions that `product.cpp` promises, one number at a time.
    fn in_order(left: &[f32], right: &[f32], [rows, depth, columns]: [usize; 3]) -> Vec<f32> {
        let number = |row: usize, column: usize| {
            let mut sum = 0.0f32;
            for terms in (0..depth).collect::<Vec<_>>().chunks(DEPTH) {
                let chain = |sum, &k: &usize| left[row * depth + k].mul_add(right[k * columns + column], sum);
                let chain = terms.iter().fold(0.0f32, chain);
                sum = if terms[0] == 0 { chain } else { sum + chain };
            }
            sum
        };
        (0..rows * columns).map(|index| number(index / columns, index % columns)).collect()
    }

    fn matrix(numbers: &[f32], rows: usize, columns: usize) -> Tensor {
        Tensor::from_slice(numbers).view([rows as i64, columns as i64])
    }

    #[test]
    fn products_are_chains_in_order() {
        assert!(is_reproducible());
        let transposed = |m: &Tensor| m.tr().contiguous().tr();
        // Two rows and columns at least: a product with a vector is MKL's.
        for (seed, shape) in (0..).zip([[7, 5, 3], [38, 560, 384], [300, 257, 21], [129, 256, 481]]) {
            let [rows, depth, columns] = shape;
            let (left, right) = (numbers(rows * depth, seed), numbers(depth * columns, 77 + seed));
            let expected = in_order(&left, &right, shape);
            let (a, b) = (matrix(&left, rows, depth), matrix(&right, depth, columns));
            for (a, b) in [(&a, &b), (&transposed(&a), &b), (&a, &transposed(&b)), (&transposed(&a), &transposed(&b))] {
                assert_eq!(to_vec(&a.mm(b)), expected, "{shape:?}");
            }
            for threads in [1, 2, 5] {
                tch::set_num_threads(threads);
                assert_eq!(to_vec(&a.mm(&b)), expected, "{shape:?}, {threads} threads");
            }
        }
    }

    #[test]
    fn a_product_is_added_to_what_is_there() {
        let (left, right) = (numbers(12 * 300, 1), numbers(300 * 20, 2));
        let (a, b) = (matrix(&left, 12, 300), matrix(&right, 300, 20));
        let bias = numbers(12 * 20, 3);
        let sum = to_vec(&matrix(&bias, 12, 20).addmm(&a, &b));
        let chains: Vec<Vec<f32>> = [0..256, 256..300]
            .map(|terms: std::ops::Range<usize>| {
                let (l, r) = (
                    a.narrow(1, terms.start as i64, terms.len() as i64),
                    b.narrow(0, terms.start as i64, terms.len() as i64),
                );
                in_order(&to_vec(&l.contiguous()), &to_vec(&r.contiguous()), [12, terms.len(), 20])
            })
            .to_vec();
        for (index, sum) in sum.iter().enumerate() {
            assert_eq!(*sum, (bias[index] + chains[0][index]) + chains[1][index]);
        }
        // What is multiplied with nothing may be no number.
        let room = Tensor::full([12, 20], f64::NAN, (Kind::Float, Device::Cpu));
        assert!(to_vec(&a.mm_out(&room, &b)).iter().all(|x| x.is_finite()));
    }

    #[test]
    fn square_roots_are_exact() {
        let numbers: Vec<f32> = numbers(100_003, 9).into_iter().map(|x| x * x * x.abs() + 1e-30).collect();
        let roots = to_vec(&Tensor::from_slice(&numbers).sqrt());
        assert!(numbers.iter().zip(&roots).all(|(x, root)| x.sqrt() == *root));
    }
}
