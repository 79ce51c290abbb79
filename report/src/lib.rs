//! What runs came to: statistics over seeds, figures, tables beside the paper's, one page.
//!
//! A [`study::Run`] is what a run's folder tells; [`Made::of`] puts runs of one configuration together, computes
//! everything once, and is then written down as `report.json`, as a page and as figures. This crate reads and writes no
//! files: `orchestrator report` does.

pub mod chart;
pub mod curves;
pub mod figures;
pub mod format;
mod page;
pub mod paper;
mod report;
pub mod results;
pub mod statistics;
pub mod study;
pub mod tables;

pub use report::{FigureSet, GroupReport, Made, Method, Options, Report, RunReport};
