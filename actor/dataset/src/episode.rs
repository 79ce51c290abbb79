//! An episode as data sets take it: what was seen before each action, what the action did, and pictures.

use crate::error::DatasetError;
use proto::step::Transition;

/// Which episode it is, and what became of it.
#[derive(Debug, Clone)]
pub struct About {
    /// Number of the kitchen.
    pub kitchen: u32,
    /// Number of the environment within the kitchen.
    pub environment: u32,
    /// Number of the episode within the environment.
    pub number: u32,
    /// In an evaluation: its number in the table of episodes.
    pub fixed: Option<u32>,
    /// Category of the target.
    pub target: &'static str,
    /// How it ended, in the words of an evaluation's table.
    pub outcome: &'static str,
    /// Seed of the run.
    pub seed: u64,
}

/// What the policy is given beside the frame.
#[derive(Debug, Clone, Copy)]
pub struct Seen {
    /// Goal vector, robot's frame, metres.
    pub goal_m: [f32; 3],
    /// Number of the action before; the number of actions at the start.
    pub previous_action: u32,
    /// Hash of the state.
    pub state_hash: u64,
}

/// What an action did.
#[derive(Debug, Clone, Copy)]
pub struct Step {
    /// Number of the action among those of the run.
    pub action: u32,
    /// What it did.
    pub transition: Transition,
    /// r and r′.
    pub rewards: [f32; 2],
}

/// Frames of one camera over an episode, one for each moment.
#[derive(Debug, Clone)]
pub struct Frames {
    /// Name of the camera: `depth`, `robot` or `outside`.
    pub name: &'static str,
    /// Width and height, pixels.
    pub side: usize,
    /// 16-bit millimetres; otherwise 8-bit RGB.
    pub is_depth: bool,
    /// Each as a PNG; otherwise pixels in rows from the top, depth in little-endian order.
    pub is_png: bool,
    /// The frames.
    pub frames: Vec<Vec<u8>>,
    /// For each channel how many pixels have each value, in all frames but the last.
    counts: Vec<Vec<u64>>,
    /// What the last frame adds to it.
    last: Vec<u8>,
}

/// An episode. There is one moment more than there are actions: the last one is what the last action led to.
#[derive(Debug, Clone)]
pub struct Episode {
    /// Which one.
    pub about: About,
    /// What was seen, one more than there are steps.
    pub seen: Vec<Seen>,
    /// What was done.
    pub steps: Vec<Step>,
    /// The robot's depth frames, then pictures.
    pub cameras: Vec<Frames>,
}

impl Frames {
    /// No frames yet.
    pub fn new(name: &'static str, side: usize, is_depth: bool, is_png: bool) -> Self {
        let counts = if is_depth { vec![vec![0; 1 << 16]] } else { vec![vec![0; 1 << 8]; 3] };
        Self { name, side, is_depth, is_png, frames: Vec::new(), counts, last: Vec::new() }
    }

    /// Adds a frame. `pixels`: rows from the top, depth in little-endian order.
    ///
    /// # Panics
    /// If it has another size.
    pub fn push(&mut self, pixels: Vec<u8>) -> Result<(), DatasetError> {
        let bytes = if self.is_depth { 2 } else { 3 };
        assert_eq!(pixels.len(), self.side * self.side * bytes, "a frame of {0} x {0} pixels", self.side);
        // The moment after the last action belongs to no step: a frame is counted when the next one comes.
        for (value, channel) in values(&self.last, self.is_depth) {
            self.counts[channel][value] += 1;
        }
        self.frames.push(if self.is_png { self.png(&pixels)? } else { pixels.clone() });
        self.last = pixels;
        Ok(())
    }

    /// Channels of a pixel.
    pub fn channels(&self) -> usize {
        self.counts.len()
    }

    /// For each channel how many pixels of the steps' frames have each value.
    pub(crate) fn counts(&self) -> &[Vec<u64>] {
        &self.counts
    }

    fn png(&self, pixels: &[u8]) -> Result<Vec<u8>, DatasetError> {
        let mut png = Vec::new();
        let mut encoder = png::Encoder::new(&mut png, self.side as u32, self.side as u32);
        encoder.set_compression(png::Compression::Fast);
        let written = if self.is_depth {
            encoder.set_color(png::ColorType::Grayscale);
            encoder.set_depth(png::BitDepth::Sixteen);
            let big_endian: Vec<u8> = pixels.chunks_exact(2).flat_map(|pair| [pair[1], pair[0]]).collect();
            encoder.write_header().and_then(|mut writer| {
                writer.write_image_data(&big_endian)?;
                writer.finish()
            })
        } else {
            encoder.set_color(png::ColorType::Rgb);
            encoder.write_header().and_then(|mut writer| {
                writer.write_image_data(pixels)?;
                writer.finish()
            })
        };
        written.map_err(DatasetError::Picture)?;
        Ok(png)
    }
}

/// Values of pixels, each with its channel.
fn values(pixels: &[u8], is_depth: bool) -> impl Iterator<Item = (usize, usize)> {
    let width = if is_depth { 2 } else { 1 };
    pixels.chunks_exact(width).enumerate().map(move |(index, bytes)| {
        let value = bytes.iter().rev().fold(0, |value, &byte| value << 8 | usize::from(byte));
        (value, if is_depth { 0 } else { index % 3 })
    })
}
