//! The viewer: a page on runs, live, and any recorded episode from any camera.
//!
//! The server is a process of its own that only reads: what runs leave on disk comes through a `data::Runs`, which the
//! orchestrator implements. So nothing of the supervisor depends on the server, and a viewer can neither slow nor end a
//! run. Episodes are simulated again and drawn by `actor show`, a child at a low priority ([`scene_renderer`]).
//!
//! ```text
//! data       what the pages show, as plain data; what a source of runs has to answer
//! feed       what is new of a run, message by message
//! foxglove   that, to Foxglove over a WebSocket
//! serve      listens; bounds on connections, headers and time
//! guard      who is answered: who has the token
//! routes     addresses to answers
//! readings   readings of runs, few at a time
//! answer     answers as JSON, and refusals
//! metrics    all runs in Prometheus' text format
//! run_feeds        one reader of a run, however many watch it
//! scene_renderer    `actor show` as a child: asked one thing at a time
//! page       the page itself, which is in the program; a report is that page with its data inside
//! ```

mod answer;
pub mod data;
pub mod feed;
mod foxglove;
mod guard;
mod metrics;
pub mod page;
mod readings;
mod routes;
mod run_feeds;
pub mod scene_renderer;
mod serve;

pub use serve::{ServeError, Settings, serve};
