//! What people read: the terminal ([`terminal`]), figures in words ([`format`](mod@format)), cells in columns
//! ([`table`]); parsing of log lines ([`log_line`]); warnings that others cause ([`seldom`]); and what scripts read while a
//! run goes on ([`events`]).

pub mod events;
pub mod format;
pub mod log_line;
pub mod table;
pub mod terminal;
pub mod warning_limiter;
