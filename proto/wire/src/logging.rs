//! One way to set up `tracing` for all binaries: to standard error, filtered by `STILLROOM_LOG` (default `info`).

use std::io::IsTerminal;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

/// Environment variable that holds the filter: levels, for all or by module, as in `warn,actor=debug`
/// (`tracing_subscriber::filter::Targets`; filters by the fields of spans would bring a compiler of regular
/// expressions).
const FILTER_VARIABLE: &str = "STILLROOM_LOG";

/// What `STILLROOM_LOG` lets through; `default` if it is not set or no filter. The second says why, where it is none.
pub fn filter(default: tracing::Level) -> (Targets, Option<String>) {
    let default = Targets::new().with_default(default).with_target("iceoryx2", tracing::Level::ERROR);
    let Some(asked) = std::env::var_os(FILTER_VARIABLE) else { return (default, None) };
    match asked.to_string_lossy().parse::<Targets>() {
        Ok(filter) => (filter, None),
        Err(error) => (default, Some(format!("{FILTER_VARIABLE} is not a filter and is ignored: {error}"))),
    }
}

/// Sends `tracing` events to standard error. iceoryx2 reports through the same subscriber, errors only
/// unless the filter sets another level. Call once, first thing in `main`.
pub fn to_stderr() {
    let (filter, problem) = filter(tracing::Level::INFO);
    let lines = tracing_subscriber::fmt::layer()
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .with_target(false)
        // A line that cannot be written is lost. The default would report the failure on standard error and panic if
        // that fails, too: a learner whose orchestrator was killed would die at its first log line without saving.
        .log_internal_errors(false);
    tracing_subscriber::registry().with(filter).with(lines).init();
    if let Some(problem) = problem {
        tracing::warn!("{problem}");
    }
}
