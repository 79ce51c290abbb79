//! A report on runs: their folders are read ([`gather`]) and the page's files written ([`files`]). The crate `report`
//! does what is between.

pub mod files;
pub mod gather;
