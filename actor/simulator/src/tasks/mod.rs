//! The tasks that are built in, each in a folder with its declaration, `task.toml`.

pub mod arm_point_nav;
