//! The robot: a body that drives and turns, a head camera that pitches, an arm that rides on the body's front.

pub mod action;
pub mod arm;
pub mod configuration;
pub mod dimensions;
pub mod links;
