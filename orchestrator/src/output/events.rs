//! What scripts read while a run goes on (`--json`): one JSON object a line on standard output.
//!
//! Every event has `event`, its name, and `at_unix_s`. docs/terminal.md lists them. Without `--json` nothing is told.

use super::terminal;
use serde::Serialize;
use serde_json::json;
use std::fmt::Debug;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::SystemTime;
use tracing::field::{Field, Visit};
use tracing::{Event, Level, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::layer::Context;

static TOLD: AtomicBool = AtomicBool::new(false);

pub fn begin() {
    TOLD.store(true, Ordering::Relaxed);
}

/// Whether events are told: then they are all that comes on standard output.
pub fn are_told() -> bool {
    TOLD.load(Ordering::Relaxed)
}

#[derive(Serialize)]
struct Told<'a, T> {
    event: &'a str,
    at_unix_s: f64,
    #[serde(flatten)]
    fields: T,
}

pub fn tell<T: Serialize>(event: &str, fields: impl FnOnce() -> T) {
    if are_told() {
        let at_unix_s = SystemTime::UNIX_EPOCH.elapsed().unwrap_or_default().as_millis() as f64 / 1000.0;
        // Figures, texts and lists always serialise; a reader that has gone is no reason to end a run.
        let _ = terminal::offer_json(&Told { event, at_unix_s, fields: fields() });
    }
}

#[derive(Debug, Clone, Copy)]
pub struct LogLines;

impl<S: Subscriber> Layer<S> for LogLines {
    fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
        let level = *event.metadata().level();
        if level <= Level::INFO && are_told() {
            let mut message = Message(String::new());
            event.record(&mut message);
            tell("log", || json!({ "level": level.as_str(), "text": message.0 }));
        }
    }
}

struct Message(String);

impl Visit for Message {
    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        if field.name() == "message" {
            self.0 = format!("{value:?}");
        }
    }
}
