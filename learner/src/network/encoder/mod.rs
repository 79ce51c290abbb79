//! The visual encoders of frames, and that of other images (`dqn.rs`). To add one of frames: a file here with its
//! `ENTRY`, a line in [`ENCODERS`], and its variant with its sizes in `proto::config::Encoder`.

mod cnn;
mod dqn;
#[cfg(test)]
mod patchwork;
mod resnet;
mod visual;

pub(crate) use dqn::Dqn;
pub(crate) use visual::{Backward, EncoderEntry, VISUAL, VisualEncoder};

use proto::config::Encoder;

pub(crate) const ENCODERS: [EncoderEntry; 2] = [resnet::ENTRY, cnn::ENTRY];

/// The encoder that the configuration names. Panics if it has no line in [`ENCODERS`].
pub(crate) fn entry(encoder: Encoder) -> EncoderEntry {
    let found = ENCODERS.into_iter().find(|entry| entry.encoder == encoder);
    found.unwrap_or_else(|| panic!("{encoder:?} has no line in ENCODERS"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_encoder_of_the_configuration_has_a_line() {
        for encoder in [Encoder::Resnet, Encoder::Cnn] {
            // Without an arm for all others: a new variant compiles only when it is here and in the list above.
            let expected = match encoder {
                Encoder::Resnet | Encoder::Cnn => 1,
            };
            assert_eq!(ENCODERS.iter().filter(|entry| entry.encoder == encoder).count(), expected, "{encoder:?}");
        }
    }

    /// What the convolutions leave of a frame, without pooling and pooled by 2 and by 4.
    #[test]
    fn the_last_layers_have_these_inputs() {
        let features = |encoder| [224, 112, 56].map(entry(encoder).features);
        assert_eq!(features(Encoder::Resnet), [128 * 7 * 7, 128 * 4 * 4, 128 * 2 * 2]);
        assert_eq!(features(Encoder::Cnn), [32 * 24 * 24, 32 * 10 * 10, 32 * 3 * 3]);
    }
}
