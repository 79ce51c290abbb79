//! What libtorch refuses. tch panics where it does, with libtorch's text as Rust writes it for programmers: between quotes,
//! lines and all, with the call stack of the C++ after the reason.

use std::any::Any;
use std::cell::Cell;
use std::panic::{AssertUnwindSafe, PanicHookInfo, catch_unwind, set_hook, take_hook};
use tracing::Level;

thread_local! {
    /// Whoever called [`caught`] tells what was refused.
    static CAUGHT: Cell<bool> = const { Cell::new(false) };
}

/// From now on a panic with libtorch's text is one line of the log, and one that is [`caught`] is no more than a line for
/// those who debug. Every other panic is printed as usual, and that with libtorch's text where `RUST_BACKTRACE` is set or
/// where the log has no errors. To be called once, after logging is set up.
pub fn say_in_a_line() {
    let usual = take_hook();
    set_hook(Box::new(move |panic| match reason(panic.payload()) {
        _ if CAUGHT.get() => tracing::debug!("{panic}"),
        Some(reason) => {
            log(&reason, panic);
            let wanted = std::env::var_os("RUST_BACKTRACE").is_some_and(|wanted| wanted != "0");
            if wanted || !tracing::enabled!(Level::ERROR) {
                usual(panic);
            }
        }
        None => usual(panic),
    }));
}

fn log(reason: &str, panic: &PanicHookInfo) {
    let place = panic.location().map_or_else(|| "nowhere".to_owned(), ToString::to_string);
    tracing::error!("libtorch refuses: {reason} (panicked at {place}; RUST_BACKTRACE=1 prints from where)");
}

/// Does something that libtorch may refuse, or a kernel of ours. Returns the reason.
pub fn caught<T>(body: impl FnOnce() -> T) -> Result<T, String> {
    let outside = CAUGHT.replace(true);
    let done = catch_unwind(AssertUnwindSafe(body));
    CAUGHT.set(outside);
    done.map_err(|payload| {
        let ours = || text(&*payload).and_then(|text| text.lines().next()).map(str::to_owned);
        reason(&*payload).or_else(ours).unwrap_or_else(|| "a panic".to_owned())
    })
}

fn text(payload: &dyn Any) -> Option<&str> {
    payload.downcast_ref::<String>().map(String::as_str).or_else(|| payload.downcast_ref::<&str>().copied())
}

/// The first line of what libtorch says, if it is libtorch that speaks: out of tch, or out of an error that we panic with.
fn reason(payload: &dyn Any) -> Option<String> {
    let text = text(payload)?;
    let reason = match text.split_once("an `Err` value: Torch(\"") {
        Some((_, quoted)) => unquoted_line(quoted),
        None => text.strip_prefix("Internal torch error: ")?.trim_start().lines().next()?.to_owned(),
    };
    Some(reason.trim_start().trim_end_matches([' ', '.']).to_owned())
}

/// The first line that is not empty of a text that Rust has quoted, whose first quotation mark is gone.
fn unquoted_line(quoted: &str) -> String {
    let mut line = String::new();
    let mut letters = quoted.chars();
    while let Some(letter) = letters.next() {
        match letter {
            '"' => break,
            '\\' => match letters.next() {
                Some('n') if line.is_empty() => {}
                Some('n') | None => break,
                Some('t' | 'r') => line.push(' '),
                Some(escaped) => line.push(escaped),
            },
            _ => line.push(letter),
        }
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::process::Command;
    use tch::{Device, Kind, Tensor};

    const SHAPE: &str = "shape '[3]' is invalid for input of size 2";

    fn refused() {
        let _ = Tensor::zeros([2], (Kind::Float, Device::Cpu)).view([3]);
    }

    #[test]
    fn what_libtorch_says_is_caught() {
        assert_eq!(caught(|| 3), Ok(3));
        assert_eq!(caught(refused), Err(SHAPE.to_owned()));
        assert_eq!(caught(|| panic!("ours\nand more")), Err::<(), _>("ours".to_owned()));
        assert_eq!(caught(|| std::panic::panic_any(3)), Err::<(), _>("a panic".to_owned()));
        assert!(!CAUGHT.get());
    }

    #[test]
    fn a_reason_is_a_line_without_quotes() {
        let of = |text: &str| reason(&format!("called `Result::unwrap()` on an `Err` value: {text}"));
        let cuda = r#"Torch("CUDA error: an \"illegal\" access\nSearch for `cudaErrorIllegalAddress'. \n")"#;
        assert_eq!(of(cuda).as_deref(), Some("CUDA error: an \"illegal\" access"));
        assert_eq!(of(r#"Torch("\n\texpected a scalar. ")"#).as_deref(), Some("expected a scalar"));
        assert_eq!(of("Io(NotFound)"), None);
        let ours = tch::TchError::Torch("CUDA out of memory.\nException raised".to_owned());
        assert_eq!(reason(&ours.to_string()).as_deref(), Some("CUDA out of memory"));
        assert_eq!(reason(&"ours"), None);
    }

    /// The test starts itself as a child.
    #[test]
    fn nobody_reads_the_call_stack_of_the_c_plus_plus() {
        const CHILD: &str = "STILLROOM_REFUSAL_TEST";
        if let Some(what) = std::env::var_os(CHILD) {
            wire::logging::to_stderr();
            say_in_a_line();
            assert!(caught(refused).is_err(), "not a word of this one");
            assert!(what != "ours", "ours");
            refused();
        }
        let (_, module) = module_path!().split_once("::").unwrap();
        let name = format!("{module}::nobody_reads_the_call_stack_of_the_c_plus_plus");
        let printed = |what: &str, trace: &str, log: &str| {
            let mut child = Command::new(std::env::current_exe().unwrap());
            child.args(["--exact", &name, "--nocapture"]).env(CHILD, what);
            child.env("RUST_BACKTRACE", trace).env("STILLROOM_LOG", log);
            let output = child.output().unwrap();
            assert!(!output.status.success());
            let text = String::from_utf8(output.stderr).unwrap();
            (text.matches(SHAPE).count(), text.matches("panicked at").count(), text)
        };
        let (reasons, panics, text) = printed("theirs", "0", "info");
        assert_eq!((reasons, panics, text.lines().count()), (1, 1, 1), "{text}");
        assert!(
            text.contains(" ERROR ") && text.contains(&format!("libtorch refuses: {SHAPE} (panicked at ")),
            "{text}"
        );
        let (reasons, panics, text) = printed("theirs", "1", "info");
        assert_eq!((reasons, panics), (2, 2), "{text}");
        let (reasons, panics, text) = printed("ours", "0", "info");
        assert_eq!((reasons, panics), (0, 1), "{text}");
        assert!(text.contains("ours"), "{text}");
        let (reasons, panics, text) = printed("theirs", "0", "off");
        assert_eq!((reasons, panics), (1, 1), "it never goes without a word: {text}");
    }
}
