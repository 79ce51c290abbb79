//! Episodes as archives of `NumPy`, one for each episode. The simulation hands over one [`Episode`] after the other.
//! `python/package/stillroom/dataset.py` makes Parquet tables and a `LeRobotDataset` of the archives.

mod episode;
mod error;
mod fields;
mod npz;
mod page;
mod writer;

pub use episode::{About, Episode, Frames, Moment};
pub use error::DatasetError;
pub use npz::npy_header;
pub use page::{Size, Source};
pub use writer::Writer;
