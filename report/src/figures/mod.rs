//! The figures of the report. Each function makes those of one question; none where nothing was recorded for it.

mod actions;
mod disturbance;
mod intervals;
mod learning;
mod optimisation;
mod parts;
mod prediction;
mod series;
mod stages;
mod sweep;
mod validation;

pub use actions::action_maps;
pub use disturbance::{by_objects, by_threshold};
pub use intervals::intervals;
pub use learning::{learning, multiplier};
pub use optimisation::optimisation;
pub use prediction::prediction;
pub use sweep::{Sweep, SweepPoint, sweep_figure, sweeps};
pub use validation::validation;
