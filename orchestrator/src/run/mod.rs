//! A run on disk and at work, be it one that trains or an evaluation: who it is ([`identity`]), one start of the
//! orchestrator on it ([`session`]), whom it leaves with ([`lifeline`]), its own scenes ([`scenes`]), what a dead one
//! leaves in shared memory ([`remains`]), and its files of one JSON object a line ([`json_lines`]).

pub mod identity;
pub mod json_lines;
pub mod lifeline;
pub mod remains;
pub mod scenes;
pub mod session;
