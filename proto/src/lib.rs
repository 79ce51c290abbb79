//! The contract between Stillroom's processes, and between them and their files.
//!
//! Everything that two processes, or a process and a file, must agree on lives here and nowhere else: tasks,
//! episodes, stages, the reward, what an environment reports of a step, the camera, the configuration, the records of
//! evaluations, the events of a learner, and the layout of a run folder. This crate contains neither physics nor
//! tensors, and no transport: what crosses shared memory, and how, is the crate `wire`.
//!
//! Beside the contract stand the few functions by which every process writes files that must survive ([`disk`],
//! [`run_folder`], [`pin`]), opens files that others may have put there ([`plain_file`]), prints commands to paste
//! ([`shell`]), and passes the places where a test kills it ([`fault`]).
//!
//! # Axes and units
//! World and robot frames follow AI2-THOR: **x right, y up, z ahead**, metres, radians. Yaw turns about +y; yaw 0
//! looks along +z and a positive yaw turns to the right (towards +x). A vector written "in the robot's frame" has
//! its origin on the floor at the body's axis and turns with the body's yaw only.

pub mod actor_notes;
pub mod bounded;
pub mod camera;
pub mod checkpoint;
pub mod config;
pub mod dataset;
pub mod device;
pub mod digest;
pub mod disk;
pub mod episode;
pub mod evaluation;
pub mod event;
pub mod exit;
pub mod fault;
pub mod figures;
pub mod grouped;
pub mod hosts;
pub mod kitchen;
pub mod kitchen_schedule;
pub mod learning_rate;
pub mod likeness;
pub mod metric;
pub mod pin;
pub mod plain_file;
pub mod policy_file;
pub mod printable;
pub mod random;
pub mod record;
pub mod replay;
pub mod run_folder;
pub mod run_state;
pub mod shares;
pub mod shell;
pub mod show;
pub mod stage;
pub mod task;
pub mod trained;

/// Version of everything that is written to a file or sent between processes. Raised on any incompatible change. Each
/// payload in shared memory has a number of its own besides, in the name of its type.
pub const SCHEMA_VERSION: u32 = 3;
