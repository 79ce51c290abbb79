//! The contract between Stillroom's processes.
//!
//! Everything that two processes, or a process and a file, must agree on lives here and nowhere else: payloads in
//! shared memory, service names and their settings, the actions, episodes, stages, the reward, the configuration,
//! and the layout of a run folder. This crate knows neither physics nor tensors.
//!
//! # Axes and units
//! World and robot frames follow AI2-THOR: **x right, y up, z ahead**, metres, radians. Yaw turns about +y; yaw 0
//! looks along +z and a positive yaw turns to the right (towards +x). A vector written "in the robot's frame" has
//! its origin on the floor at the body's axis and turns with the body's yaw only.

pub mod action;
pub mod config;
pub mod control;
pub mod episode;
pub mod evaluation;
pub mod fault;
mod ffi;
pub mod kitchen;
pub mod lifeline;
pub mod logging;
pub mod message;
pub mod processor;
pub mod random;
pub mod replay;
pub mod reward;
pub mod run_folder;
pub mod shares;
pub mod stage;
pub mod wire;

/// Version of everything that crosses a process boundary or is written to a file. Raised on any incompatible change.
pub const SCHEMA_VERSION: u32 = 3;
