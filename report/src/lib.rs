//! Reports on runs: statistics over seeds, and tables beside the paper's.
//!
//! A [`study::Run`] is the content of a run's folder. [`Report::of`] groups runs of one configuration and computes
//! everything once; serialised, the result is `report.json`, and the page draws it. This crate reads and writes no files:
//! `orchestrator report` does.
//!
//! Two seeds of one preset as plain data, and the report about them:
//!
//! ```
//! use proto::config::Config;
//! use proto::metric;
//! use proto::run_state::{Ending, RunState};
//! use report::study::{Origin, Rollout, Run};
//! use report::{Options, Report};
//! use std::collections::BTreeMap;
//!
//! let run = |seed: u64| {
//!     let config = Config { seed, ..Config::resolve("demo", None).expect("a preset") };
//!     let rollout = |index: u64| Rollout {
//!         frames: 4_400 * index,
//!         metrics: BTreeMap::from([(metric::EPISODES.to_owned(), 19.0), ("episode/success".to_owned(), 0.01)]).into(),
//!         ..Rollout::default()
//!     };
//!     Run {
//!         name: format!("runs/demo-{seed}"),
//!         origin: Origin::Run(RunState::Ended(Ending::Complete)),
//!         config,
//!         rollouts: (1..=100).map(rollout).collect(),
//!         newest_tenth: BTreeMap::from([("success".to_owned(), 0.01 * seed as f64)]),
//!         evaluations: Vec::new(),
//!         validation: Vec::new(),
//!     }
//! };
//! let report = Report::of(&[run(1), run(2)], &Options::default(), Vec::new())?;
//! assert_eq!(report.groups[0].runs.len(), 2, "runs that differ in the seed only are one group");
//! assert_eq!(report.groups[0].newest_tenth["success"], 0.015);
//! # Ok::<(), report::study::StudyError>(())
//! ```

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
pub use sweep::{Sweep, SweepPoint};
