//! A report on runs: what their folders tell ([`gather`]), and the files of the page ([`files`]). What lies between is
//! the crate `report`.

pub mod files;
pub mod gather;
