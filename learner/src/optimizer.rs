//! Adam (Kingma and Ba 2015) over one flat buffer, with PyTorch's arithmetic: β = (0.9, 0.999).

use tch::{Kind, Tensor};

const BETA_1: f64 = 0.9;
const BETA_2: f64 = 0.999;

#[derive(Debug)]
pub struct Adam {
    /// Running mean of the gradient, \[parameters\].
    pub first: Tensor,
    /// Running mean of its square, \[parameters\].
    pub second: Tensor,
    pub steps: u64,
}

impl Adam {
    pub fn new(weights: &Tensor) -> Self {
        Self { first: weights.zeros_like(), second: weights.zeros_like(), steps: 0 }
    }

    pub fn step(&mut self, weights: &mut Tensor, gradient: &Tensor, learning_rate: f64, epsilon: f64) {
        self.steps += 1;
        let power = self.steps.min(i32::MAX as u64) as i32;
        let correction_1 = 1.0 - BETA_1.powi(power);
        let correction_2 = 1.0 - BETA_2.powi(power);
        tch::no_grad(|| {
            let _ = self.first.lerp_(gradient, 1.0 - BETA_1);
            let _ = self.second.g_mul_scalar_(BETA_2).addcmul_(gradient, &(gradient * (1.0 - BETA_2)));
            let denominator = self.second.sqrt().g_div_scalar_(correction_2.sqrt()).g_add_scalar_(epsilon);
            let _ = weights.g_sub_(&(&self.first / denominator).g_mul_scalar_(learning_rate / correction_1));
        });
    }

    /// A copy that later steps leave alone.
    #[must_use]
    pub fn copy(&self) -> Self {
        Self { first: self.first.copy(), second: self.second.copy(), steps: self.steps }
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
