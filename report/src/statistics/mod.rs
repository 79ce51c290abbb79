//! Means over seeds and kitchens, and how far they can be trusted, as Agarwal et al., *Deep Reinforcement Learning at
//! the Edge of the Statistical Precipice* (2021) recommend and the rliable library computes them.
//!
//! By hand: no crate has rliable's bootstrap, and `tests/reference.rs` compares ours with rliable's own numbers.

mod aggregate;
mod bootstrap;
mod scores;
mod wilson;

pub use aggregate::{Aggregate, Estimate};
pub(crate) use bootstrap::{CURVE_RESAMPLES, RESAMPLES};
pub use bootstrap::{Interval, intervals_over};
pub use scores::{Scores, ScoresError, interquartile_mean};
pub use wilson::wilson;
