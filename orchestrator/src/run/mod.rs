//! A run on disk, be it one that trains or an evaluation: its folder ([`create`]), who it is
//! ([`identity`]), who works on it ([`lock`]) and how it stands ([`state`]); its checkpoints
//! ([`checkpoints`]), its parent ([`lifeline`]), its own scenes ([`scenes`]), what a dead one leaves in shared memory ([`remains`]), a signal to its
//! orchestrator or learner ([`signal`]) and whether one of them is stopped ([`process_state`]), files of one JSON object
//! a line ([`json_lines`]), a file that cannot be understood ([`damaged`]), and a folder that was never made to its end
//! ([`unfinished`]).

pub mod checkpoints;
pub mod create;
pub mod cut_off;
pub mod damaged;
pub mod identity;
pub mod json_lines;
pub mod lifeline;
pub mod lock;
pub mod process_state;
pub mod remains;
pub mod scale;
pub mod scenes;
pub mod signal;
pub mod state;
pub mod unfinished;
