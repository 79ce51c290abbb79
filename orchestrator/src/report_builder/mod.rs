//! A report on runs: reads their folders and writes the page's files. The crate `report` does what is between.

pub mod files;
pub mod gather;
mod strips;
mod unclaimed;
