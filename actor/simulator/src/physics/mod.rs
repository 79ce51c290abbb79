//! Physics: collision geometry of shapes, the rigid-body world, the fixed scene that blocks the robot, and what movable
//! things do.

pub(crate) mod fixed_scene;
pub mod gap;
pub mod geometry;
pub(crate) mod sweep;
pub(crate) mod things;
pub mod world;
