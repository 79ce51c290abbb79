//! The encoder of any image: three convolutions without padding and a linear layer (Mnih et al. 2015), initialised as in
//! the PPO of `CleanRL` for Atari games.

use crate::network::initialize::Initial;
use crate::network::layers::{Convolution, Linear};
use crate::network::parameters::{Layout, Parameters};
use proto::config::dqn;
use proto::task::Image;
use std::f64::consts::SQRT_2;
use tch::Tensor;

#[derive(Debug)]
pub(crate) struct Dqn {
    convolutions: Vec<Convolution>,
    linear: Linear,
}

impl Dqn {
    /// Declares its layers for an image. Every second entry of PyTorch's Sequential is a rectifier, and one flattens.
    pub fn new(layout: &mut Layout, path: &str, image: &Image) -> Self {
        let initial = [Initial::Orthogonal { gain: SQRT_2 }, Initial::Constant(0.0)];
        let mut channels = image.channels as i64;
        let mut convolutions = vec![];
        for (index, (outputs, size, stride)) in dqn::CONVOLUTIONS.into_iter().enumerate() {
            let [sizes, geometry] = [[channels, outputs as i64], [size as i64, stride as i64]];
            let path = format!("{path}.{}", 2 * index);
            convolutions.push(Convolution::without_padding(layout, &path, sizes, geometry, initial).as_products());
            channels = outputs as i64;
        }
        let features = dqn::features(image) as i64;
        let [weight, bias] = initial;
        let sizes = [features, dqn::OUTPUTS as i64];
        Self { convolutions, linear: Linear::new(layout, &format!("{path}.7"), sizes, weight, bias) }
    }

    /// \[rows, channels, height, width\] → \[rows, 512\].
    pub fn forward(&self, parameters: &Parameters, images: &Tensor) -> Tensor {
        let convolve = |x: Tensor, convolution: &Convolution| convolution.forward(parameters, &x).relu_();
        let features = self.convolutions.iter().fold(images.shallow_clone(), convolve);
        self.linear.forward(parameters, &features.flatten(1, -1)).relu_()
    }
}
