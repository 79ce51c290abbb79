//! The simulator: kitchens, robot, physics, depth camera and the task; and the rollout actor's process.

pub mod environment;
pub mod kitchen;
pub mod shape;
