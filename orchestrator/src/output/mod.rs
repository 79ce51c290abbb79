//! What people read, and what scripts read while a run goes on ([`events`]).

pub mod events;
pub mod format;
pub mod log_line;
pub mod name;
pub mod table;
pub mod terminal;
