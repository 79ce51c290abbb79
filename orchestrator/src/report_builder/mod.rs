//! A report on runs: their folders are read ([`gather`], [`unclaimed`], [`evaluated`]) and the page's files written
//! ([`files`]), with episodes in pictures ([`strips`]). The crate `report` does what is between.

mod evaluated;
pub mod files;
pub mod gather;
pub mod kept;
mod strips;
mod unclaimed;
