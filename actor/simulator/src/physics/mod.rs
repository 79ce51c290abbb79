//! Physics: collision geometry of shapes, the rigid-body world, the fixed scene that blocks the robot, and what movable
//! things do.

pub mod gap;
pub mod geometry;
pub(crate) mod scene;
pub(crate) mod sweep;
pub(crate) mod things;
pub mod watch;
pub mod world;
