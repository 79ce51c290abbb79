//! What people read: the terminal ([`terminal`]) and figures in words ([`format`](mod@format)); and parsing of log
//! lines ([`log_line`]).

pub mod format;
pub mod log_line;
pub mod terminal;
