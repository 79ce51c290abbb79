//! The one way to the terminal: results on standard output, logs and live progress on standard error.
//!
//! A progress line stays below the log: every log line first clears it and then draws it again. Nothing here fails:
//! when the reader of a pipe has gone or the terminal was closed, a run goes on without being watched. Only at the end a
//! program says that results are lost, as on a full disk: [`demand_written`].

use super::name::as_called;
use super::table::{below_paths, wrapped};
use proto::printable::printable;
use serde::Serialize;
use std::borrow::Cow;
use std::fs::File;
use std::io::{IsTerminal, Write};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tracing_subscriber::fmt::MakeWriter;
use tracing_subscriber::fmt::format::Writer;
use tracing_subscriber::fmt::time::FormatTime;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{Layer, Registry};

struct State {
    drawn: Vec<String>,
    file: Option<File>,
    muted: bool,
    /// Why a result did not reach standard output, if its reader has not just gone.
    unwritten: Option<std::io::Error>,
}

static STATE: Mutex<State> = Mutex::new(State { drawn: Vec::new(), file: None, muted: false, unwritten: None });

fn state() -> MutexGuard<'static, State> {
    // A panic while printing leaves nothing that could be inconsistent.
    STATE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Sends `tracing` events to standard error and, once [`log_to_file`] was called, to the run's log.
///
/// `also` receives them, too. `STILLROOM_LOG` filters all.
pub fn init(verbose: bool, also: Box<dyn Layer<Registry> + Send + Sync>) {
    let default = if verbose { tracing::Level::DEBUG } else { tracing::Level::INFO };
    let (filter, problem) = wire::logging::filter(default);
    let terminal = tracing_subscriber::fmt::layer()
        .with_target(false)
        .with_timer(SinceStart(Instant::now()))
        .with_ansi(std::io::stderr().is_terminal())
        .log_internal_errors(false)
        .with_writer(Screen);
    let file = tracing_subscriber::fmt::layer()
        .with_ansi(false)
        .log_internal_errors(false)
        .with_writer(LogFile)
        .with_filter(tracing_subscriber::filter::LevelFilter::DEBUG);
    // A second call (tests) changes nothing.
    let _ = tracing_subscriber::registry().with(also).with(filter).with(terminal).with(file).try_init();
    if let Some(problem) = problem {
        tracing::warn!("{problem}");
    }
}

pub fn log_to_file(file: File) {
    state().file = Some(file);
}

pub fn mute(muted: bool) {
    state().muted = muted;
}

pub fn out(line: &str) {
    if let Err(error) = offer(line)
        && !is_unread(&error)
    {
        state().unwritten.get_or_insert(error);
    }
}

/// Whether writing to standard output failed with this only because nobody reads it any more: the reader of a pipe has
/// gone, or the terminal was closed.
pub fn is_unread(error: &std::io::Error) -> bool {
    // A terminal that was closed does not answer as one (`isatty`). It is still a character device, and a file on a
    // broken disk, which gives the same error, is none.
    let is_device = || {
        let stat = rustix::fs::fstat(std::io::stdout());
        stat.is_ok_and(|stat| rustix::fs::FileType::from_raw_mode(stat.st_mode).is_char_device())
    };
    error.kind() == std::io::ErrorKind::BrokenPipe
        || (error.raw_os_error() == Some(rustix::io::Errno::IO.raw_os_error()) && is_device())
}

/// Fails if a line did not reach standard output, other than for want of a reader.
pub fn demand_written() -> anyhow::Result<()> {
    match state().unwritten.take() {
        Some(error) => Err(anyhow::Error::new(error).context("cannot write to standard output")),
        None => Ok(()),
    }
}

/// The same for what is of no use without a reader: fails when there is none any more.
pub fn offer(line: &str) -> std::io::Result<()> {
    let mut state = state();
    let drawn = erase(&mut state);
    let mut stdout = std::io::stdout().lock();
    let written = writeln!(stdout, "{}", printable(&as_called(line))).and_then(|()| stdout.flush());
    draw(&mut state, drawn);
    written
}

pub fn out_json(value: &impl Serialize) -> serde_json::Result<()> {
    out(&ascii_controls(&serde_json::to_string(value)?));
    Ok(())
}

pub fn offer_json(value: &impl Serialize) -> std::io::Result<()> {
    offer(&ascii_controls(&serde_json::to_string(value)?))
}

/// JSON in which what a terminal would obey is escaped as JSON escapes, not as [`printable`] does.
fn ascii_controls(json: &str) -> String {
    let mut text = String::with_capacity(json.len());
    for character in json.chars() {
        match printable(character.encode_utf8(&mut [0; 4])) {
            Cow::Borrowed(_) => text.push(character),
            Cow::Owned(_) => text.extend(format!("\\u{:04x}", u32::from(character)).chars()),
        }
    }
    text
}

/// On standard error, broken between words where that is a terminal that is too narrow.
pub fn note(text: &str) {
    let width = live_columns().unwrap_or(usize::MAX);
    let mut state = state();
    let drawn = erase(&mut state);
    for line in as_called(text).lines().flat_map(|line| wrapped(line, width)) {
        let _ = writeln!(std::io::stderr(), "{}", printable(&line));
    }
    draw(&mut state, drawn);
}

pub fn interactive() -> bool {
    std::io::stderr().is_terminal() && std::env::var_os("TERM").is_none_or(|term| term != "dumb")
}

/// A table is no narrower.
const NARROWEST: usize = 20;

fn columns() -> usize {
    let size = rustix::termios::tcgetwinsize(std::io::stderr());
    size.map_or(80, |size| usize::from(size.ws_col)).max(20) - 1
}

/// Columns of standard error, if that is an [`interactive`] terminal.
pub fn live_columns() -> Option<usize> {
    interactive().then(columns)
}

/// Columns of standard output, if that is a terminal; elsewhere those of the variable `COLUMNS`, if it is set.
pub fn width() -> Option<usize> {
    let asked = || std::env::var("COLUMNS").ok()?.parse().ok();
    let size = rustix::termios::tcgetwinsize(std::io::stdout());
    size.map_or_else(|_| asked(), |size| Some(usize::from(size.ws_col))).filter(|&columns| columns >= NARROWEST)
}

/// Like [`out`], broken between words where standard output is a terminal that is too narrow.
pub fn out_wrapped(text: &str) {
    let width = width().unwrap_or(usize::MAX);
    // The program's name is replaced in the whole text: a command could be broken between two lines.
    as_called(text).lines().flat_map(|line| wrapped(line, width)).for_each(|line| out(&line));
}

/// A table, with each path in a line of its own where it would be wider than the terminal.
pub fn out_table(rows: &[Vec<String>]) {
    for line in below_paths(rows, width()) {
        out(&line);
    }
}

/// Replaces the progress lines at the bottom of the screen; none removes them. Only for an [`interactive`] terminal.
pub fn progress(lines: Vec<String>) {
    let mut state = state();
    erase(&mut state);
    draw(&mut state, lines);
}

/// Without a terminal that can be refreshed, a line of progress as often as this.
const LINE_EVERY: Duration = Duration::from_secs(5);
const REFRESHED_EVERY: Duration = Duration::from_millis(100);

/// How work gets on: one line, refreshed in place on an [`interactive`] terminal, written every few seconds elsewhere.
pub struct Live {
    interactive: bool,
    last_line: Option<Duration>,
}

impl Default for Live {
    fn default() -> Self {
        Self { interactive: interactive(), last_line: None }
    }
}

impl Live {
    pub fn is_due(&mut self, now: Duration) -> bool {
        let every = if self.interactive { REFRESHED_EVERY } else { LINE_EVERY };
        let due = self.last_line.is_none_or(|last| now.saturating_sub(last) >= every);
        if due {
            self.last_line = Some(now);
        }
        due
    }

    pub fn columns(&self) -> Option<usize> {
        self.interactive.then(columns)
    }

    pub fn show(&self, line: String) {
        if self.interactive {
            progress(vec![line]);
        } else {
            note(&line);
        }
    }

    pub fn clear(&self) {
        if self.interactive {
            progress(Vec::new());
        }
    }
}

fn erase(state: &mut State) -> Vec<String> {
    let drawn = std::mem::take(&mut state.drawn);
    if !drawn.is_empty() {
        // To the first progress line, then clear to the end of the screen.
        let up = drawn.len() - 1;
        let sequence = if up == 0 { "\r\x1b[J".to_owned() } else { format!("\r\x1b[{up}A\x1b[J") };
        let _ = std::io::stderr().write_all(sequence.as_bytes());
    }
    drawn
}

fn draw(state: &mut State, lines: Vec<String>) {
    if lines.is_empty() {
        return;
    }
    // A wrapped line would be more than one on the screen, and erasing would miss its top.
    let columns = columns();
    let cut: Vec<String> = lines.iter().map(|line| printable(line).chars().take(columns).collect()).collect();
    let _ = std::io::stderr().write_all(cut.join("\n").as_bytes());
    state.drawn = lines;
}

struct SinceStart(Instant);

impl FormatTime for SinceStart {
    fn format_time(&self, writer: &mut Writer<'_>) -> std::fmt::Result {
        write!(writer, "[{:7.1}s]", self.0.elapsed().as_secs_f64())
    }
}

#[derive(Clone, Copy)]
struct Screen;

impl Write for Screen {
    fn write(&mut self, line: &[u8]) -> std::io::Result<usize> {
        let mut state = state();
        if state.muted {
            return Ok(line.len());
        }
        let drawn = erase(&mut state);
        let _ = std::io::stderr().write_all(as_called(&String::from_utf8_lossy(line)).as_bytes());
        draw(&mut state, drawn);
        Ok(line.len())
    }
    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

impl<'a> MakeWriter<'a> for Screen {
    type Writer = Screen;
    fn make_writer(&'a self) -> Self::Writer {
        *self
    }
}

#[derive(Clone, Copy)]
struct LogFile;

impl Write for LogFile {
    fn write(&mut self, line: &[u8]) -> std::io::Result<usize> {
        if let Some(file) = &mut state().file {
            let _ = file.write_all(line);
        }
        Ok(line.len())
    }
    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

impl<'a> MakeWriter<'a> for LogFile {
    type Writer = LogFile;
    fn make_writer(&'a self) -> Self::Writer {
        *self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn json_is_json_whatever_a_name_holds() {
        let name = "r\u{2032} \u{9b}2J \u{202e} \u{1b}[2J \n \\";
        let text = ascii_controls(&serde_json::to_string(name).unwrap());
        assert!(matches!(printable(&text), Cow::Borrowed(_)), "{text}");
        assert!(text.contains('\u{2032}'), "{text}");
        assert_eq!(serde_json::from_str::<String>(&text).unwrap(), name);
    }

    #[test]
    fn where_nothing_can_be_refreshed_a_line_comes_now_and_then() {
        let mut live = Live { interactive: false, last_line: None };
        let shown = (0..=20).filter(|&half_s| live.is_due(Duration::from_millis(500 * half_s)));
        assert_eq!(shown.collect::<Vec<_>>(), [0, 10, 20]);
        let mut live = Live { interactive: true, last_line: None };
        assert!((0..5).all(|second| live.is_due(Duration::from_secs(second))));
    }
}
