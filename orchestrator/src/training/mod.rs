//! A run that trains, from folder to summary ([`run`]): what is kept of each rollout ([`metrics`]), their means
//! ([`means`]), validation beside it ([`validation`]) and what came of it ([`scores`]), its wall time ([`wall`]), its end ([`summary`]), and another
//! budget for it ([`budget`]). [`audience`] hears what the learner says.

pub mod audience;
pub mod budget;
pub mod means;
pub mod metrics;
pub mod run;
pub mod scores;
pub mod summary;
pub mod validation;
pub mod wall;
