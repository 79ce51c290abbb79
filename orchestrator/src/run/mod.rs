//! A run on disk, be it one that trains or an evaluation: its folder, who it is, and who works on it.

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
