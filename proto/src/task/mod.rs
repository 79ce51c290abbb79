//! A task, declared once, as data: what an environment reports at every step, the actions that it takes, the rewards and
//! metrics that are made of its reports.
//!
//! The record in shared memory and its check on arrival, the rewards that stages name, and the metrics of figures and
//! tables follow from this declaration. A task that is built in lies in a folder of its own, with its `task.toml`, beside
//! its environment in `actor/simulator/src/tasks/`.

mod actions;
mod channel;
mod check;
mod columns;
mod description;
mod error;
mod figure;
mod head;
mod image;
mod inputs;
mod layout;
mod metric;
mod outcome;
mod read;
mod resolve;
mod restore;
mod reward;
mod space;
mod spec;
mod sums;
#[cfg(test)]
mod tests;

pub use actions::{Actions, NUMBERS_MOST};
pub use channel::{Channel, Dtype, Role};
pub use check::{Check, Implausible};
pub use description::{Description, REWARD};
pub use error::SpecError;
pub use figure::{Column, Curve, Described, Figure, Take};
pub use head::{ActionHead, PolicyAction};
pub use image::Image;
pub use inputs::{Inputs, Place};
pub use layout::{Field, HEADER_BYTES, LINE_BYTES, Layout};
pub use metric::{Clause, Comparison, Kind, Limit, Measure, Metric, Over};
pub use outcome::UNFINISHED;
pub use read::{Declaration, is_reserved};
pub use restore::Restore;
pub use reward::{Composition, Condition, Cost, Label, MULTIPLIER, NEGATIVE_MULTIPLIER, Reward, Term, Weight};
pub use space::ActionSpace;
pub use spec::Spec;
pub use sums::{Summing, Sums};
