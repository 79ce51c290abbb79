//! Physics: collision geometry of shapes, the rigid-body world, and the fixed scene that blocks the robot.

pub mod geometry;
pub mod scene;
pub mod world;
