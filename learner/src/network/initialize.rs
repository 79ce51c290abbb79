//! Initial weights: the same bits on every machine, from the run's seed and the parameter's name alone.
//!
//! A parameter's number in the random key is a hash of its name, so its initial values do not depend on which other
//! modules the network has: two runs that differ in an auxiliary head start from the same encoder.

use proto::random::{Key, Purpose, Random};
use std::f64::consts::TAU;

/// Values drawn from one random stream before the next begins; a stream is limited to 262,140 words.
const BLOCK: usize = 65_536;

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Initial {
    Constant(f64),
    Normal {
        deviation: f64,
    },
    /// Uniform in (-bound, bound).
    Uniform {
        bound: f64,
    },
    /// A random (semi-)orthogonal matrix, uniform over all such (Saxe et al. 2013); what
    /// `torch.nn.init.orthogonal_` draws from. More than two dimensions are one row for each of the first.
    Orthogonal {
        /// Factor on the matrix.
        gain: f64,
    },
}

impl Initial {
    /// Kaiming normal as the reference calls it: the gain of `ReLU`, √2, is passed where the slope of a leaky
    /// rectifier is expected, so the deviation is sqrt(2 / (3 · `fan_in`)).
    pub(crate) fn kaiming_normal(fan_in: i64) -> Self {
        Self::Normal { deviation: (2.0 / (3.0 * fan_in as f64)).sqrt() }
    }

    /// Default of `torch.nn.Linear`: uniform within ±1/sqrt(`fan_in`).
    pub(crate) fn linear_default(fan_in: i64) -> Self {
        Self::Uniform { bound: 1.0 / (fan_in as f64).sqrt() }
    }

    /// Draws a parameter of this shape, row-major. Panics if an orthogonal parameter is not a matrix.
    pub fn draw(self, seed: u64, name: &str, shape: &[i64]) -> Vec<f32> {
        let count: usize = shape.iter().product::<i64>() as usize;
        match self {
            Self::Constant(value) => vec![value as f32; count],
            Self::Normal { deviation } => {
                normals(seed, name, count).into_iter().map(|value| (value * deviation) as f32).collect()
            }
            Self::Uniform { bound } => draw(seed, name, count, |random, values| {
                values.fill_with(|| bound * (2.0 * random.uniform_open() - 1.0));
            })
            .into_iter()
            .map(|value| value as f32)
            .collect(),
            Self::Orthogonal { gain } => {
                assert!(shape.len() > 1, "{name}: only a matrix can be orthogonal");
                let rows = shape[0] as usize;
                orthogonal(&normals(seed, name, count), rows, count / rows)
                    .into_iter()
                    .map(|value| (gain * value) as f32)
                    .collect()
            }
        }
    }
}

/// Standard normal numbers.
fn normals(seed: u64, name: &str, count: usize) -> Vec<f64> {
    draw(seed, name, count, fill_normal)
}

/// Fills in standard normal numbers by Box and Muller's transform.
pub(crate) fn fill_normal(random: &mut Random, values: &mut [f64]) {
    for pair in values.chunks_mut(2) {
        let radius = (-2.0 * libm::log(random.uniform_open())).sqrt();
        let angle = TAU * random.uniform_open();
        pair[0] = radius * libm::cos(angle);
        if let [_, second] = pair {
            *second = radius * libm::sin(angle);
        }
    }
}

fn draw(seed: u64, name: &str, count: usize, mut fill: impl FnMut(&mut Random, &mut [f64])) -> Vec<f64> {
    let mut values = vec![0.0; count];
    for (block, chunk) in values.chunks_mut(BLOCK).enumerate() {
        let key = Key {
            seed,
            purpose: Purpose::Weights,
            kitchen: 0,
            environment: number_of(name),
            episode: block as u32,
            step: 0,
        };
        fill(&mut key.stream(), chunk);
    }
    values
}

/// FNV-1a, 32 bits.
pub(super) fn number_of(name: &str) -> u32 {
    name.bytes().fold(0x811c_9dc5, |hash, byte| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193))
}

/// The orthogonal factor of a row-major matrix: of its QR decomposition with a positive diagonal of R, which makes
/// the factor unique and its distribution uniform. A wide matrix is transposed before and after.
///
/// Gram and Schmidt's method, each vector swept twice: once is not orthogonal enough, a third time changes nothing
/// (Giraud et al. 2005). Plain f64 additions and products in a fixed order, so the same bits on every machine;
/// LAPACK's blocking would differ with the processor.
fn orthogonal(matrix: &[f64], rows: usize, columns: usize) -> Vec<f64> {
    let transpose = rows < columns;
    let (length, count) = if transpose { (columns, rows) } else { (rows, columns) };
    let mut vectors: Vec<Vec<f64>> = (0..count)
        .map(|j| {
            (0..length).map(|i| if transpose { matrix[j * columns + i] } else { matrix[i * columns + j] }).collect()
        })
        .collect();
    for j in 0..count {
        let (done, rest) = vectors.split_at_mut(j);
        let vector = &mut rest[0];
        for _ in 0..2 {
            for unit in &*done {
                let along = dot(unit, vector);
                for (value, direction) in vector.iter_mut().zip(unit) {
                    *value -= along * direction;
                }
            }
        }
        let norm = dot(vector, vector).sqrt();
        assert!(norm > 1e-9, "random normal vectors are independent");
        for value in vector {
            *value /= norm;
        }
    }
    let mut result = vec![0.0; matrix.len()];
    for (j, vector) in vectors.iter().enumerate() {
        for (i, &value) in vector.iter().enumerate() {
            result[if transpose { j * columns + i } else { i * columns + j }] = value;
        }
    }
    result
}

/// Eight partial sums: a fixed order that vectorises.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; 8];
    let (a_eights, a_rest) = a.as_chunks::<8>();
    let (b_eights, b_rest) = b.as_chunks::<8>();
    for (a, b) in a_eights.iter().zip(b_eights) {
        for lane in 0..8 {
            sums[lane] += a[lane] * b[lane];
        }
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    ((sums[0] + sums[4]) + (sums[1] + sums[5])) + ((sums[2] + sums[6]) + (sums[3] + sums[7])) + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orthogonal_factors_are_orthogonal_and_keep_the_span_of_the_leading_vectors() {
        for (rows, columns) in [(96, 40), (40, 96), (33, 33)] {
            let matrix = normals(3, "test", rows * columns);
            let q = orthogonal(&matrix, rows, columns);
            let (length, count) = (rows.max(columns), rows.min(columns));
            let vector = |m: &[f64], j: usize| -> Vec<f64> {
                (0..length).map(|i| if rows < columns { m[j * columns + i] } else { m[i * columns + j] }).collect()
            };
            for i in 0..count {
                for j in 0..count {
                    let expected = if i == j { 1.0 } else { 0.0 };
                    assert!((dot(&vector(&q, i), &vector(&q, j)) - expected).abs() < 1e-12);
                }
                // R = QᵀA is upper triangular with a positive diagonal.
                assert!(dot(&vector(&q, i), &vector(&matrix, i)) > 0.0);
                for j in 0..i {
                    assert!(dot(&vector(&q, i), &vector(&matrix, j)).abs() < 1e-10);
                }
            }
        }
    }

    #[test]
    fn draws_have_the_moments_asked_for_and_differ_by_name_and_seed() {
        let shape = [300, 700];
        let moments = |values: &[f32]| {
            let mean = values.iter().map(|&v| f64::from(v)).sum::<f64>() / values.len() as f64;
            let variance = values.iter().map(|&v| (f64::from(v) - mean).powi(2)).sum::<f64>() / values.len() as f64;
            (mean, variance.sqrt())
        };
        let normal = Initial::Normal { deviation: 0.5 }.draw(1, "a", &shape);
        let (mean, deviation) = moments(&normal);
        assert!(mean.abs() < 0.005 && (deviation - 0.5).abs() < 0.005, "{mean} {deviation}");
        let uniform = Initial::Uniform { bound: 0.25 }.draw(1, "a", &shape);
        let (mean, deviation) = moments(&uniform);
        assert!(mean.abs() < 0.002 && (deviation - 0.25 / 3f64.sqrt()).abs() < 0.002, "{mean} {deviation}");
        assert!(uniform.iter().all(|value| value.abs() <= 0.25));
        assert_ne!(normal, Initial::Normal { deviation: 0.5 }.draw(1, "b", &shape));
        assert_ne!(normal, Initial::Normal { deviation: 0.5 }.draw(2, "a", &shape));
        // The second block is not the first again.
        assert_ne!(normal[..100], normal[BLOCK..BLOCK + 100]);
    }

    #[test]
    fn the_reference_calls_kaiming_with_the_gain_as_slope() {
        assert_eq!(Initial::kaiming_normal(49), Initial::Normal { deviation: (2.0f64 / 147.0).sqrt() });
    }
}
