//! `actor episodes`: the fixed episodes, drawn anew or checked.
//!
//! `draw` makes them from a fixed seed, [`crate::check::episode`] says what an episode must satisfy, and
//! [`simulator::tasks::arm_point_nav::episodes`] keeps the file and its hash.

pub mod command;
mod draw;
