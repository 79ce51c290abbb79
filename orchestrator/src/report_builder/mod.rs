//! A report on runs: their folders are read ([`gather`], [`unclaimed`]) and the page's files written
//! ([`files`]), with episodes in pictures ([`strips`]). The crate `report` does what is between.

pub mod files;
pub mod gather;
pub mod kept;
mod strips;
mod unclaimed;
