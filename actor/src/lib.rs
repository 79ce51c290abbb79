//! The rollout actor's process, and what proves, shows and measures the simulator.

pub mod arguments;
pub mod bench;
pub mod categories;
pub mod check;
pub mod episodes;
pub mod export;
pub mod harvest;
pub mod kitchen_export;
pub mod oracle_table;
pub mod parallel;
pub mod process;
pub mod replay;
pub mod sheet;
pub mod show;
