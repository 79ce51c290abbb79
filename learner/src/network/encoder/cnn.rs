//! The original baseline's encoder: three convolutions without padding (`docs/method.md`, Network). No rectifier
//! follows the third, as in the reference.

use super::visual::{EncoderEntry, PATH, VisualEncoder, visual_linear};
use crate::network::layers::{Convolution, Linear};
use crate::network::parameters::{Layout, Parameters};
use proto::config::Encoder;
use tch::Tensor;

/// Path of the linear layer.
const LINEAR: &str = "visual_encoder.cnn.6";

pub(crate) const ENTRY: EncoderEntry = EncoderEntry {
    encoder: Encoder::Cnn,
    linear: LINEAR,
    features,
    declare: |layout, side| Box::new(Cnn::new(layout, PATH, side)),
    allenact: &[
        ("visual_encoder.cnn.0.", "visual_encoder.depth_cnn.conv_0."),
        ("visual_encoder.cnn.2.", "visual_encoder.depth_cnn.conv_1."),
        ("visual_encoder.cnn.4.", "visual_encoder.depth_cnn.conv_2."),
        ("visual_encoder.cnn.6.", "visual_encoder.depth_cnn.fc."),
    ],
};

/// (outputs, size, stride) of each convolution.
const CONVOLUTIONS: [(i64, i64, i64); 3] = [(32, 8, 4), (64, 4, 2), (32, 3, 1)];

#[derive(Debug)]
struct Cnn {
    convolutions: Vec<Convolution>,
    linear: Linear,
}

/// Numbers that the convolutions leave of a square frame.
fn features(side: i64) -> i64 {
    let side = CONVOLUTIONS.iter().fold(side, |side, (_, size, stride)| (side - size) / stride + 1);
    CONVOLUTIONS[2].0 * side * side
}

impl Cnn {
    fn new(layout: &mut Layout, path: &str, side: i64) -> Self {
        let mut channels = 1;
        let mut convolutions = vec![];
        for (index, (outputs, size, stride)) in CONVOLUTIONS.into_iter().enumerate() {
            // Every second entry of PyTorch's Sequential is a rectifier.
            let path = format!("{path}.cnn.{}", 2 * index);
            convolutions
                .push(Convolution::new(layout, &path, [channels, outputs], size, [stride, 0], true).as_products());
            channels = outputs;
        }
        // After the third convolution: flatten, linear, rectifier.
        Self { convolutions, linear: visual_linear(layout, LINEAR, features(side)) }
    }
}

impl VisualEncoder for Cnn {
    fn forward(&self, parameters: &Parameters, frames: &Tensor) -> Tensor {
        let mut x = self.convolutions[0].forward(parameters, frames).relu_();
        x = self.convolutions[1].forward(parameters, &x).relu_();
        x = self.convolutions[2].forward(parameters, &x);
        self.linear.forward(parameters, &x.flatten(1, -1)).relu_()
    }
}
