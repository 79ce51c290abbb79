use tracing::Level;

/// Before the sentence of a program that serves environments and has no log yet.
pub const ERROR: &str = "stillroom: error: ";

/// A line of a child's standard error, as `wire::logging` writes it: `2026-11-21T02:04:23.1Z  WARN text`; or of the
/// orchestrator's log, which has the place in the program before the text.
#[derive(Debug, PartialEq, Eq)]
pub struct LogLine<'a> {
    pub level: Option<Level>,
    pub text: &'a str,
}

impl<'a> LogLine<'a> {
    pub fn parse(line: &'a str) -> Self {
        if let Some(text) = line.strip_prefix(ERROR) {
            return Self { level: Some(Level::ERROR), text };
        }
        let plain = Self { level: None, text: line };
        let Some((time, rest)) = line.split_once(' ') else { return plain };
        if !(time.ends_with('Z') && time.contains('T') && time.starts_with(|first: char| first.is_ascii_digit())) {
            return plain;
        }
        let rest = rest.trim_start();
        let (level, text) = rest.split_once(' ').unwrap_or((rest, ""));
        let level = match level {
            "TRACE" => Level::TRACE,
            "DEBUG" => Level::DEBUG,
            "INFO" => Level::INFO,
            "WARN" => Level::WARN,
            "ERROR" => Level::ERROR,
            _ => return plain,
        };
        let text = match text.split_once(": ") {
            Some((place, rest)) if place.contains("::") && !place.contains(' ') => rest,
            _ => text,
        };
        Self { level: Some(level), text }
    }
}

/// The error at the end of a log: the first line that one of our programs logged as an error, without its time, and
/// everything after it. None if there is no such line.
pub fn error_in(text: &str) -> Option<&str> {
    text.split_once(" ERROR ").map(|(_, error)| error)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn log_lines_are_told_from_cries() {
        assert_eq!(
            LogLine::parse("2026-11-21T02:04:23.123456Z  WARN it is late"),
            LogLine { level: Some(Level::WARN), text: "it is late" }
        );
        let at_a_place =
            LogLine::parse("2026-11-21T02:04:23.1Z  INFO orchestrator::supervisor::shell: actor-01: ready");
        assert_eq!(at_a_place, LogLine { level: Some(Level::INFO), text: "actor-01: ready" });
        let panic = "thread 'main' panicked at src/main.rs:3:5:";
        assert_eq!(LogLine::parse(panic), LogLine { level: None, text: panic });
        let refused = "stillroom: error: there is no file mine.py";
        assert_eq!(LogLine::parse(refused), LogLine { level: Some(Level::ERROR), text: "there is no file mine.py" });
        assert_eq!(LogLine::parse(""), LogLine { level: None, text: "" });
    }

    #[test]
    fn an_error_is_what_was_logged_as_one() {
        assert_eq!(error_in("2026-11-21T02:04:23.1Z  INFO a\n2026-11-21T02:04:23.1Z ERROR b\nc"), Some("b\nc"));
        assert_eq!(error_in("[   0.3s] ERROR no such file"), Some("no such file"));
        assert_eq!(error_in("thread 'main' panicked"), None);
    }
}
