//! The orchestrator.

mod command;
mod format;
mod recorder;
mod recording;
mod schema;
mod terminal;

fn main() {}
