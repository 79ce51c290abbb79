//! The simulator: kitchens, robot, physics, depth camera and the task; and the rollout actor's process.

pub mod bench;
pub mod depth;
pub mod environment;
pub mod kitchen;
pub mod process;
pub mod replay;
pub mod shape;
