//! Small inputs: the numbers beside the frame and the previous action.

use super::initialize::Initial;
use super::layers::Linear;
use super::parameters::{Layout, ParameterId, Parameters};
use proto::config::GoalCoordinates;
use std::f64::consts::{FRAC_PI_2, PI};
use tch::Tensor;

/// Width of the goal's embedding.
pub const GOAL: i64 = 32;
/// Width of the previous action's embedding.
pub const PREVIOUS_ACTION: i64 = 16;

/// What the network is given for the numbers that a record has: a vector in space comes first, and what is behind it
/// stays. Panics if there are fewer than three numbers, and those are to be a vector in space.
pub fn coordinates(kind: GoalCoordinates, numbers: &[f32]) -> Vec<f32> {
    if kind == GoalCoordinates::Plain {
        return numbers.to_vec();
    }
    let (vector, rest) = numbers.split_first_chunk().expect("a vector in space has three numbers");
    [&goal_coordinates(kind, *vector), rest].concat()
}

/// What the network is given for a goal vector in the robot's frame (x right, y up, z ahead), metres.
///
/// Polar: (ρ, elevation / (π/2), azimuth / π) with elevation = atan2(z, hypot(x, y)) and azimuth = atan2(y, x): the
/// reference applies the textbook's formulas, in which z is up, to AI2-THOR's axes; so do we. Cartesian: (|x|, |y|,
/// |z|), the original baseline. Plain: as it is.
pub fn goal_coordinates(kind: GoalCoordinates, [x, y, z]: [f32; 3]) -> [f32; 3] {
    match kind {
        GoalCoordinates::Plain => [x, y, z],
        GoalCoordinates::Cartesian => [x.abs(), y.abs(), z.abs()],
        GoalCoordinates::Polar => {
            let [x, y, z] = [x, y, z].map(f64::from);
            let distance = (x * x + y * y + z * z).sqrt();
            let elevation = libm::atan2(z, (x * x + y * y).sqrt());
            let azimuth = libm::atan2(y, x);
            [distance as f32, (elevation / FRAC_PI_2) as f32, (azimuth / PI) as f32]
        }
    }
}

/// Numbers → 100 → `LeakyReLU` → 32.
#[derive(Debug)]
pub struct GoalEmbedding {
    first: Linear,
    second: Linear,
}

impl GoalEmbedding {
    pub fn new(layout: &mut Layout, path: &str, numbers: i64) -> Self {
        Self {
            first: Linear::with_default(layout, &format!("{path}.0"), [numbers, 100]),
            second: Linear::with_default(layout, &format!("{path}.2"), [100, GOAL]),
        }
    }

    /// \[rows, numbers\] → \[rows, 32\].
    pub fn forward(&self, parameters: &Parameters, goal: &Tensor) -> Tensor {
        // `leaky_relu` has PyTorch's default slope, 0.01.
        self.second.forward(parameters, &self.first.forward(parameters, goal).leaky_relu())
    }
}

/// One row an action of the policy, and row 0 for "none yet".
#[derive(Debug)]
pub struct ActionEmbedding {
    weight: ParameterId,
}

impl ActionEmbedding {
    /// Declares the table for this many policy actions, standard normal as `torch.nn.Embedding`.
    pub fn new(layout: &mut Layout, path: &str, actions: i64) -> Self {
        let initial = Initial::Normal { deviation: 1.0 };
        Self { weight: layout.add(format!("{path}.weight"), &[actions + 1, PREVIOUS_ACTION], initial) }
    }

    /// Rows of the table \[rows\], from [`table_row`] → \[rows, 16\].
    pub fn forward(&self, parameters: &Parameters, rows: &Tensor) -> Tensor {
        Tensor::embedding(&parameters[self.weight], rows, -1, false, false)
    }
}

/// Row of the embedding for a previous action, if there was one, among those of the policy; `None` if it has no such action.
/// Actions without names have no embedding.
pub(crate) fn table_row(space: &[u8], previous_action: Option<u8>) -> Option<i64> {
    let Some(action) = previous_action.filter(|_| !space.is_empty()) else { return Some(0) };
    space.iter().position(|&other| other == action).map(|index| index as i64 + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn previous_actions_have_rows_of_their_own() {
        let [large, small]: [Vec<u8>; 2] = [(0..21).collect(), vec![0, 1, 16, 20]];
        assert_eq!(
            [table_row(&large, None), table_row(&large, Some(20)), table_row(&large, Some(21))],
            [Some(0), Some(21), None]
        );
        assert_eq!([table_row(&small, Some(20)), table_row(&small, Some(14))], [Some(4), None]);
        assert_eq!(table_row(&[], Some(20)), Some(0));
    }
}
