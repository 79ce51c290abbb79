//! A run that trains, from folder to summary ([`run`]).

pub mod audience;
pub mod budget;
pub mod events;
pub mod means;
pub mod metrics;
pub mod next_steps;
pub mod progress;
pub mod restarts;
pub mod run;
pub mod scores;
pub mod summary;
pub mod tensorboard;
pub mod validation;
pub mod wall;
