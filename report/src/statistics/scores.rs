#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum ScoresError {
    #[error("no scores: at least one seed and one kitchen are needed")]
    Empty,
    #[error("seed {seed} has {found} scores, the first has {expected}")]
    Ragged { seed: usize, expected: usize, found: usize },
}

#[derive(Debug, Clone, PartialEq)]
pub struct Scores {
    pub(super) kitchens: usize,
    /// \[seeds × kitchens\], seed by seed.
    pub(super) values: Vec<f64>,
}

impl Scores {
    /// One row a seed, all of them over the same kitchens in the same order.
    pub fn new(rows: &[Vec<f64>]) -> Result<Self, ScoresError> {
        let kitchens = rows.first().map_or(0, Vec::len);
        if kitchens == 0 {
            return Err(ScoresError::Empty);
        }
        if let Some(seed) = rows.iter().position(|row| row.len() != kitchens) {
            return Err(ScoresError::Ragged { seed, expected: kitchens, found: rows[seed].len() });
        }
        Ok(Self { kitchens, values: rows.concat() })
    }

    pub fn seeds(&self) -> usize {
        self.values.len() / self.kitchens
    }

    pub fn row(&self, seed: usize) -> &[f64] {
        &self.values[seed * self.kitchens..][..self.kitchens]
    }

    pub fn mean(&self) -> f64 {
        let mut sums = vec![0.0; self.kitchens];
        for row in self.values.chunks_exact(self.kitchens) {
            for (sum, score) in sums.iter_mut().zip(row) {
                *sum += score;
            }
        }
        let seeds = self.seeds() as f64;
        sums.iter().map(|sum| sum / seeds).sum::<f64>() / self.kitchens as f64
    }

    pub fn interquartile_mean(&self) -> f64 {
        interquartile_mean(&self.values)
    }
}

/// The mean of what is left when a quarter of the values, rounded down to whole ones, is cut off at either end.
///
/// # Panics
/// If there are no values.
pub fn interquartile_mean(values: &[f64]) -> f64 {
    assert!(!values.is_empty(), "a mean over nothing");
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let cut = sorted.len() / 4;
    let middle = &sorted[cut..sorted.len() - cut];
    middle.iter().sum::<f64>() / middle.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_matrix_is_refused() {
        assert_eq!(Scores::new(&[]), Err(ScoresError::Empty));
        assert_eq!(Scores::new(&[vec![]]), Err(ScoresError::Empty));
        let ragged = ScoresError::Ragged { seed: 1, expected: 2, found: 1 };
        assert_eq!(Scores::new(&[vec![0.0, 1.0], vec![0.0]]), Err(ragged));
    }
}
