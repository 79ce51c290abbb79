//! The simulator as a whole.

// Helpers of tests are tests too, which clippy's own exception does not see.
#![allow(clippy::unwrap_used)]

mod determinism;
mod foreign_scenes;
mod kept;
mod robot;
mod support;
mod task;
