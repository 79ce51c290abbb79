//! Episodes as data sets for other programs. Whoever simulates them hands over one [`Episode`] after the other; a
//! [`Writer`] holds no more than one group of rows of them.
//!
//! ```text
//! episode   what an episode is here
//! fields    what is held of every step: one table for all formats
//! column    columns of a table, and their schema
//! table     a Parquet file that is written group by group
//! lerobot   a LeRobotDataset v3
//! stats     its statistics
//! tables    two plain Parquet tables
//! npz       an archive of `NumPy` an episode
//! page      the page that says what is in the folder
//! writer    any of them, into a folder that is there whole or not at all
//! ```

mod column;
mod episode;
mod error;
mod fields;
mod lerobot;
mod npz;
mod page;
mod source;
mod stats;
mod table;
mod tables;
mod writer;

pub use episode::{About, Episode, Frames, Seen, Step};
pub use error::DatasetError;
pub use source::{Size, Source};
pub use writer::Writer;
