//! Reports on runs: statistics over seeds, and tables beside the paper's.
//!
//! A [`study::Run`] is the content of a run's folder. [`Report::of`] groups runs of one configuration and computes
//! everything once; serialised, the result is `report.json`, and the page draws it. This crate reads and writes no files:
//! `orchestrator report` does.

pub mod comparison;
pub mod curves;
pub mod format;
mod kept;
mod method;
pub mod paper;
mod report;
pub mod results;
pub mod statistics;
pub mod study;
mod sweep;

pub use kept::{Kept, KeptError};
pub use method::level_of;
pub use report::{GroupReport, IntervalMethod, Options, Report, RunReport, StageReport, TaskReport};
pub use results::FieldResult;
pub use sweep::{Sweep, SweepPoint};
