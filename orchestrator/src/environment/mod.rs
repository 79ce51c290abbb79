//! Environments that are not built in: a command of the user's simulates them.
//!
//! ```text
//! describe  asks a command once what its environments are
//! consent   which commands this user has allowed
//! growth    actors whose memory grows
//! ```

pub mod consent;
pub mod describe;
pub mod growth;
