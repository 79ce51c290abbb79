//! What people read: the terminal ([`terminal`]), figures in words ([`format`](mod@format)), live progress
//! ([`progress`]), the commands that come next ([`next_steps`]); and log lines, read again ([`log_line`]).

pub mod format;
pub mod log_line;
pub mod next_steps;
pub mod progress;
pub mod terminal;
