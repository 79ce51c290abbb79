//! A run that trains, from folder to summary ([`run`]): what is kept of each rollout ([`metrics`]), their means
//! ([`means`]), validation beside it ([`validation`]) and its results ([`scores`]), its wall time ([`wall`]), its end
//! ([`summary`]), the commands that come next ([`next_steps`]), and another budget for it ([`budget`]). [`audience`]
//! receives the learner's events, [`progress`] shows them live, [`tensorboard`] writes them for TensorBoard, [`events`]
//! tells scripts.

pub mod audience;
pub mod budget;
pub mod events;
pub mod means;
pub mod metrics;
pub mod next_steps;
pub mod progress;
pub mod run;
pub mod scores;
pub mod summary;
pub mod tensorboard;
pub mod validation;
pub mod wall;
