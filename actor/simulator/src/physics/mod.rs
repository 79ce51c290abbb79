//! Physics: collision geometry of shapes, the rigid-body world, the fixed scene that blocks the robot, and what movable
//! things do.

pub mod gap;
pub mod geometry;
pub mod scene;
pub mod sweep;
pub mod things;
pub mod watch;
pub mod world;
