//! One way to set up `tracing` for all binaries: to standard error, filtered by `STILLROOM_LOG` (default `info`).

use std::io::IsTerminal;
use tracing_subscriber::EnvFilter;

/// Environment variable that holds the filter, in `tracing_subscriber::EnvFilter` syntax.
pub const FILTER_VARIABLE: &str = "STILLROOM_LOG";

/// Sends `tracing` events to standard error. iceoryx2 reports through the same subscriber, errors only
/// unless the filter sets another level. Call once, first thing in `main`.
pub fn to_stderr() {
    let asked = std::env::var(FILTER_VARIABLE).ok();
    let parsed = asked.as_deref().map(EnvFilter::try_new);
    let problem = parsed.as_ref().and_then(|parsed| parsed.as_ref().err().map(ToString::to_string));
    let filter = parsed.and_then(Result::ok).unwrap_or_else(|| EnvFilter::new("info,iceoryx2=error"));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .with_target(false)
        // A line that cannot be written is lost. The default would report the failure on standard error and panic if
        // that fails, too: a learner whose orchestrator was killed would die at its first log line without saving.
        .log_internal_errors(false)
        .init();
    if let Some(problem) = problem {
        tracing::warn!("{FILTER_VARIABLE} is not a filter and is ignored: {problem}");
    }
}
