//! The figures of the report. Each function makes those of one question; none where nothing was recorded for it.

mod actions;
mod disturbance;
mod episodes;
mod intervals;
mod learning;
mod optimisation;
mod parts;
mod prediction;
mod series;
mod stages;
mod sweep;
mod validation;

pub(crate) use actions::action_maps;
pub(crate) use disturbance::{by_objects, by_threshold};
pub(crate) use episodes::episodes;
pub use episodes::{ShownPair, ShownStrip};
pub(crate) use intervals::intervals;
pub(crate) use learning::{learning, multiplier};
pub(crate) use optimisation::optimisation;
pub(crate) use prediction::prediction;
pub use sweep::{Sweep, SweepPoint};
pub(crate) use sweep::{sweep_figure, sweeps};
pub(crate) use validation::validation;
