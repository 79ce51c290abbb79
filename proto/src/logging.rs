//! One way to set up `tracing` for all binaries: to standard error, filtered by `STILLROOM_LOG` (default `info`).

use std::io::IsTerminal;
use tracing_subscriber::EnvFilter;

/// Environment variable that holds the filter, in `tracing_subscriber::EnvFilter` syntax.
pub const FILTER_VARIABLE: &str = "STILLROOM_LOG";

/// Sends `tracing` events to standard error. iceoryx2 reports through the same subscriber, at `warn` and above
/// unless the filter says otherwise. Call once, first thing in `main`.
pub fn to_stderr() {
    let filter = EnvFilter::try_from_env(FILTER_VARIABLE).unwrap_or_else(|_| EnvFilter::new("info,iceoryx2=error"));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .with_target(false)
        .init();
}
