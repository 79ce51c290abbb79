//! Adam (Kingma and Ba 2015) over one flat buffer, with PyTorch's arithmetic: β = (0.9, 0.999).

use crate::device::upload;
use tch::{Kind, Tensor};

const BETA_1: f64 = 0.9;
const BETA_2: f64 = 0.999;

#[derive(Debug)]
pub struct Adam {
    /// Running mean of the gradient, \[parameters\]. This and the next keep their addresses: recorded steps write there.
    pub first: Tensor,
    /// Running mean of its square, \[parameters\].
    pub second: Tensor,
    pub steps: u64,
}

impl Adam {
    pub fn new(weights: &Tensor) -> Self {
        Self { first: weights.zeros_like(), second: weights.zeros_like(), steps: 0 }
    }

    /// As it was made.
    pub fn restart(&mut self) {
        let _ = (self.first.zero_(), self.second.zero_());
        self.steps = 0;
    }

    /// What the next `count` steps have of their numbers, on the device: f32 \[count, 2\], √(1 − β₂ᵗ) and the learning
    /// rate divided by 1 − β₁ᵗ. Of the first a GPU has the reciprocal, by which libtorch multiplies there.
    pub fn factors(&self, count: usize, learning_rate: f64) -> Tensor {
        let device = self.first.device();
        let of = |step: u64| {
            let power = step.min(i32::MAX as u64) as i32;
            let deviation = (1.0 - BETA_2.powi(power)).sqrt() as f32;
            let rate = (learning_rate / (1.0 - BETA_1.powi(power))) as f32;
            [if device.is_cuda() { 1.0 / deviation } else { deviation }, rate]
        };
        let steps = self.steps + 1..=self.steps + count as u64;
        upload(&steps.flat_map(of).collect::<Vec<_>>(), device).view([-1, 2])
    }

    /// Changes the weights by a gradient; `factors` are the step's row. The caller counts the step.
    pub fn apply(&self, weights: &Tensor, gradient: &Tensor, factors: &Tensor, epsilon: f64) {
        let (mut first, mut second) = (self.first.shallow_clone(), self.second.shallow_clone());
        let [deviation, rate] = [0, 1].map(|index| factors.select(0, index));
        tch::no_grad(|| {
            let _ = first.lerp_(gradient, 1.0 - BETA_1);
            let _ = second.g_mul_scalar_(BETA_2).addcmul_(gradient, &(gradient * (1.0 - BETA_2)));
            let mut root = second.sqrt();
            let root = if root.device().is_cuda() { root.g_mul_(&deviation) } else { root.g_div_(&deviation) };
            let change = (first / (root + epsilon)).g_mul_(&rate);
            let _ = weights.shallow_clone().g_sub_(&change);
        });
    }

    /// A copy that later steps leave alone.
    #[must_use]
    pub fn copy(&self) -> Self {
        Self { first: self.first.copy(), second: self.second.copy(), steps: self.steps }
    }

    /// As a copy has it.
    pub(crate) fn restore(&mut self, copy: &Self) {
        self.first.copy_(&copy.first);
        self.second.copy_(&copy.second);
        self.steps = copy.steps;
    }
}

/// Euclidean norm of a flat gradient, a scalar on its device. In double: millions of squares in f32 lose the fourth
/// digit on the CPU.
pub fn norm(gradient: &Tensor) -> Tensor {
    gradient.norm_scalaropt_dtype(2, Kind::Double)
}

/// Scales a flat gradient that has this norm down to one of at most `max_norm`, as `torch.nn.utils.clip_grad_norm_`
/// does. The norm stays on the device: nobody waits for it.
pub fn clip(gradient: &mut Tensor, norm: &Tensor, max_norm: f64) {
    let scale = norm.full_like(max_norm) / (norm + 1e-6);
    let _ = gradient.g_mul_(&scale.clamp_max(1.0).to_kind(gradient.kind()));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::to_vec;

    #[test]
    fn the_norm_of_a_whole_networks_gradient_has_all_its_digits() {
        let count = 5_800_000;
        let gradient = Tensor::full([count], 1e-3, (Kind::Float, tch::Device::Cpu));
        let exact = f64::from(1e-3f32) * (count as f64).sqrt();
        let norm = norm(&gradient).double_value(&[]);
        assert!((norm - exact).abs() < 1e-9 * exact, "{norm} is not {exact}");
    }

    #[test]
    fn only_long_gradients_are_clipped() {
        let mut long = Tensor::from_slice(&[3f32, 4.0]);
        let length = norm(&long);
        assert_eq!(length.double_value(&[]), 5.0);
        clip(&mut long, &length, 0.5);
        assert!(to_vec(&long).iter().zip([0.3, 0.4]).all(|(a, b)| (a - b).abs() < 1e-6));
        let mut short = Tensor::from_slice(&[0.3f32, 0.4]);
        let length = norm(&short);
        assert!((length.double_value(&[]) - 0.5).abs() < 1e-6);
        clip(&mut short, &length, 0.6);
        assert_eq!(to_vec(&short), [0.3, 0.4]);
        // Nobody looks at the norm on the way: what is not finite must not come out as if it were.
        let mut broken = Tensor::from_slice(&[f32::NAN, 1.0]);
        let length = norm(&broken);
        clip(&mut broken, &length, 0.5);
        assert!(to_vec(&broken).iter().all(|number| number.is_nan()));
    }
}
