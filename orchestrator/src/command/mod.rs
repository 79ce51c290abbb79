//! One file a command: each reads its arguments, calls what does the work, and prints.

pub mod recover;
pub mod replay;
