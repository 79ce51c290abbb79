//! Reports on runs: statistics over seeds, figures, tables beside the paper's, one page.
//!
//! A [`study::Run`] is the content of a run's folder. [`Made::of`] groups runs of one configuration and computes
//! everything once; its result becomes `report.json`, the page and the figures. This crate reads and writes no files:
//! `orchestrator report` does.
//!
//! Two seeds of one preset as plain data, and the page about them:
//!
//! ```
//! use proto::config::Config;
//! use proto::metric;
//! use proto::run_state::{Ending, RunState};
//! use report::study::{Origin, Rollout, Run};
//! use report::{Made, Options};
//!
//! let run = |seed: u64| {
//!     let config = Config { seed, ..Config::resolve("demo", None).expect("a preset") };
//!     let rollout = |index: u64| Rollout {
//!         frames: 4_400 * index,
//!         metrics: [(metric::EPISODES, 19.0), (metric::SUCCESS, 0.005 * index as f64)]
//!             .map(|(name, value)| (name.to_owned(), value))
//!             .into(),
//!         ..Rollout::default()
//!     };
//!     Run {
//!         name: format!("runs/demo-{seed}"),
//!         origin: Origin::Run(RunState::Ended(Ending::Complete)),
//!         config,
//!         rollouts: (1..=100).map(rollout).collect(),
//!         evaluations: Vec::new(),
//!         validation: Vec::new(),
//!     }
//! };
//! let made = Made::of(&[run(1), run(2)], &Options::default(), Vec::new())?;
//! assert_eq!(made.report.groups[0].runs.len(), 2, "runs that differ in the seed only are one group");
//! let page = made.page("Made by hand.");
//! assert!(page.contains("<figure id=\"learning\"") && page.contains("has been evaluated yet"));
//! # Ok::<(), report::study::StudyError>(())
//! ```

mod chart;
pub mod comparison;
pub mod curves;
mod figures;
pub mod format;
mod kept;
mod method;
mod page;
pub mod paper;
mod report;
pub mod results;
pub mod statistics;
pub mod study;
mod styled_group;

pub use chart::{Figure, Frame};
pub use figures::{ShownPair, ShownStrip, Sweep, SweepPoint};
pub use kept::{Kept, KeptError};
pub use method::level_of;
pub use report::{FigureSet, GroupReport, IntervalMethod, Made, Options, Report, RunReport};
