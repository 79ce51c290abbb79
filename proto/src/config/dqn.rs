//! The encoder of images but the frame: three convolutions without padding and a linear layer (Mnih et al. 2015).

use crate::task::Image;

/// (outputs, size, stride) of each convolution.
pub const CONVOLUTIONS: [(usize, usize, usize); 3] = [(32, 8, 4), (64, 4, 2), (64, 3, 1)];

/// Width of what the linear layer makes of them.
pub const OUTPUTS: usize = 512;

/// Numbers that the convolutions leave of an image.
pub fn features(image: &Image) -> usize {
    let left = |side| CONVOLUTIONS.iter().fold(side, |side, (_, size, stride)| (side - size) / stride + 1);
    CONVOLUTIONS[2].0 * left(image.height) * left(image.width)
}

/// About how many weights it has.
pub fn weights(image: &Image) -> u64 {
    (features(image) * OUTPUTS) as u64 + 80_000
}

/// About what autograd keeps of an image, both directions, bytes: its numbers, and maps of up to eight times as many as it
/// has pixels.
pub fn autograd_bytes(image: &Image) -> u64 {
    (image.height * image.width * (image.channels + 8) * 4 * 2) as u64
}
