//! Environments that are not built in: a command of the user's simulates them.

pub mod consent;
pub mod describe;
pub mod growth;
