//! A run on disk, be it one that trains or an evaluation: its folder ([`create`]), who it is
//! ([`identity`]), who works on it and so how it stands ([`lock`]); its checkpoints
//! ([`checkpoints`]), its parent ([`lifeline`]), its own scenes ([`scenes`]), what a dead one leaves in shared memory ([`remains`]), a signal to its
//! orchestrator or learner ([`signal`]) and whether one of them is stopped ([`process_state`]), files of one JSON object
//! a line ([`json_lines`]), and a folder that was never made to its end
//! ([`unfinished`]).

pub mod checkpoints;
pub mod create;
pub mod cut_off;
pub mod identity;
pub mod json_lines;
pub mod lifeline;
pub mod lock;
pub mod process_state;
pub mod remains;
pub mod scale;
pub mod scenes;
pub mod signal;
pub mod unfinished;

/// What is said of a file of a run that cannot be understood. Ours are written atomically, so something else did it.
pub fn damaged(path: &std::path::Path, remedy: &str) -> String {
    format!("{} is damaged ({remedy})", path.display())
}
