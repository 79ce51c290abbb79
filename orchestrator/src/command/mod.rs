//! One file a command: each reads its arguments, calls what does the work, and prints.

pub mod clean;
pub mod compare;
pub mod completions;
pub mod config;
pub mod doctor;
pub mod eval;
pub mod export;
mod host_flags;
pub mod import;
pub mod kitchens;
pub mod list;
pub mod logs;
pub mod man;
pub mod overrides;
pub mod presets;
pub mod recover;
pub mod replay;
pub mod report;
pub mod resume;
pub mod scale;
pub mod status;
pub mod stop;
pub mod suite;
pub mod top;
pub mod tune;
pub mod up;
pub mod view;
