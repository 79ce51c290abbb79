//! The viewer: a page on runs, live, and any recorded episode from any camera.
//!
//! The server is a process of its own that only reads: what runs leave on disk comes through a `data::Runs`, which the
//! orchestrator implements. So nothing of the supervisor depends on the server, and a viewer can neither slow nor end a
//! run. Episodes are simulated again and drawn by `actor show`, a child at a low priority ([`scene_renderer`]).

mod answer;
pub mod data;
mod guard;
pub mod page;
mod readings;
mod routes;
mod run_feeds;
pub mod scene_renderer;
mod serve;

pub use serve::{ServeError, Settings, serve};
