//! An episode as data sets take it: a record and what the engine says for each moment, and pictures.

use proto::record::End;

#[derive(Debug, Clone)]
pub struct About {
    pub kitchen: u32,
    pub environment: u32,
    pub number: u32,
    /// In an evaluation: its number in the table of episodes.
    pub fixed: Option<u32>,
    /// How it ended, in the words of an evaluation's table.
    pub outcome: String,
    /// The task's metrics; not a number where one is none.
    pub metrics: Vec<f64>,
    pub seed: u64,
}

#[derive(Debug, Clone)]
pub struct Moment {
    /// All of the task's record but its header and images.
    pub record: Vec<u8>,
    pub state_hash: u64,
    /// The task's rewards of the action; none at the start.
    pub rewards: Vec<f32>,
    /// How the action ended the episode, if it did.
    pub end: Option<End>,
}

#[derive(Debug, Clone)]
pub struct Frames {
    /// Name of the camera: that of the task's image, `robot` or `outside`.
    pub name: String,
    /// Width and height, pixels.
    pub side: usize,
    /// 16-bit millimetres; otherwise 8-bit RGB.
    pub is_depth: bool,
    /// Pixels in rows from the top, depth in little-endian order.
    pub frames: Vec<Vec<u8>>,
}

/// An episode. There is one moment more than there are actions: the first is its start.
#[derive(Debug, Clone)]
pub struct Episode {
    pub about: About,
    pub moments: Vec<Moment>,
    /// The robot's frames, then pictures.
    pub cameras: Vec<Frames>,
}
