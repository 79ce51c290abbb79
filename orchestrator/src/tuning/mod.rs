//! Tuning: which shape of a run is fastest on this machine. [`search`] decides what to try next, a pure state machine;
//! [`trial`] is a short real run.

pub mod search;
pub mod trial;
