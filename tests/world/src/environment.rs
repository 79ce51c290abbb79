//! The stand-in for an actor's environment that the collector's own tests use.

#[path = "../../../learner/tests/support/environment.rs"]
mod stand_in;

pub use stand_in::{FakeEnvironment, mix};
