//! The name of this program: `orchestrator`, and in a wheel `stillroom` as well. Texts are written with the first one, and
//! a user of the other reads commands as that user types them.

use clap::error::ErrorKind;
use std::borrow::Cow;
use std::io::{IsTerminal, Write};
use std::path::Path;
use std::sync::LazyLock;

const NAME: &str = "orchestrator";
const OTHER: &str = "stillroom";

fn is_other(program: &str) -> bool {
    Path::new(program).file_name().is_some_and(|name| name == OTHER)
}

static OTHER_WAS_CALLED: LazyLock<bool> =
    LazyLock::new(|| std::env::args_os().next().is_some_and(|program| is_other(&program.to_string_lossy())));

/// The name by which a shell finds it.
pub fn called() -> &'static str {
    if *OTHER_WAS_CALLED { OTHER } else { NAME }
}

/// A text whose commands begin with the name that was called.
pub fn as_called(text: &str) -> Cow<'_, str> {
    if *OTHER_WAS_CALLED { Cow::Owned(with_other(text)) } else { Cow::Borrowed(text) }
}

/// Only commands: in quotation marks, or of an example that stands in a line of its own.
fn with_other(text: &str) -> String {
    let mut text = text.to_owned();
    // Help is wrapped, also between a command's words.
    for (before, after) in [
        ("`", " "),
        ("`", "\n"),
        ("\n  ", " "),
        ("\n    ", " "),
        ("HOST ", " "),
        ("<(", " "),
        ("completions/", "\n"),
        ("zfunc/_", "\n"),
        ("/", ".fish"),
    ] {
        text = text.replace(&format!("{before}{NAME}{after}"), &format!("{before}{OTHER}{after}"));
    }
    text
}

/// Prints help or an error of the command line, and ends the program.
pub fn exit(error: &clap::Error) -> ! {
    let is_terminal =
        if error.use_stderr() { std::io::stderr().is_terminal() } else { std::io::stdout().is_terminal() };
    let is_dumb = std::env::var_os("TERM").is_some_and(|term| term == "dumb");
    let styled = is_terminal && !is_dumb && std::env::var_os("NO_COLOR").is_none();
    let text = error.render();
    let text = if styled { text.ansi().to_string() } else { text.to_string() };
    let is_error = error.use_stderr() && error.kind() != ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand;
    // The tip stands right below its error.
    let text = if is_error { text.replace("\n\n", "\n") } else { text };
    let text = as_called(&text);
    let mut stream: Box<dyn Write> =
        if error.use_stderr() { Box::new(std::io::stderr()) } else { Box::new(std::io::stdout()) };
    // Without a reader the text has no use.
    let _ = stream.write_all(text.as_bytes()).and_then(|()| stream.flush());
    std::process::exit(error.exit_code())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_have_the_name_that_was_called_and_sentences_stay() {
        assert!(is_other("stillroom") && is_other("/usr/bin/stillroom") && !is_other("target/release/orchestrator"));
        let text = "the orchestrator ended: `orchestrator resume RUN`\nExamples:\n  orchestrator up   trains";
        let other = "the orchestrator ended: `stillroom resume RUN`\nExamples:\n  stillroom up   trains";
        assert_eq!(with_other(text), other);
        for text in [
            "as `orchestrator\nscale` does",
            "-- \\\n    orchestrator up",
            "HOST orchestrator top",
            "<(orchestrator man)",
        ] {
            assert_eq!(with_other(text), text.replace(NAME, OTHER));
        }
    }
}
