//! The simulator: kitchens, robot, physics, depth camera and the task; and the rollout actor's process.

pub mod bench;
pub mod depth;
pub mod environment;
pub mod episode;
pub mod episodes;
pub mod export;
pub mod gltf;
pub mod kitchen;
pub mod oracle;
pub mod physics;
pub mod picture;
pub mod process;
pub mod replay;
pub mod robot;
pub mod shape;
pub mod simulation;
pub mod soak;
