//! `orchestrator`: starts and supervises a run, shows how it stands, stops it, goes on with it, replays what it
//! recorded. Each command is a file in [`command`].
//!
//! The program is [`main`]. What else can be named from outside is the supervisor's machine ([`Supervisor`]): it is pure, and
//! there for the simulated world among the tests.

mod command;
mod comparison;
mod environment;
mod evaluation;
mod hosts;
mod output;
mod preflight;
mod process_end;
mod replay;
mod report_builder;
mod run;
mod suite;
mod supervisor;
mod training;
mod tui;
mod viewer;
mod wrong;

pub use supervisor::clock::Clock;
pub use supervisor::deadlines::Deadlines;
pub use supervisor::event::{Action, Event, Exit, Outcome, Process, Saved, SessionEnd};
pub use supervisor::machine::Supervisor;

use anyhow::Context;
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use output::table::beside;
use rustix::process::Signal;
use std::process::ExitCode;

/// Trains mobile manipulators that leave a kitchen as they found it
#[derive(Debug, Parser)]
#[command(
    version,
    propagate_version = true,
    after_help = "Exit status: 0 when all went well (an orderly stop included), 1 on failure, 2 if the command line, or \
                  a file or folder that it names, is wrong or not there, 6 if recordings are damaged or not complete \
                  (recover, replay), 7 if a host of the run was lost, 75 if it was saved for a scheduler that starts it \
                  again (SIGUSR1, or a launcher's SIGTERM), 130 after a second Ctrl-C."
)]
struct CommandLine {
    #[command(subcommand)]
    command: Command,
    /// Show the children's ordinary log lines, too (the variable `STILLROOM_LOG` filters more finely)
    #[arg(short, long, global = true)]
    verbose: bool,
    /// The process that started this one: it is interrupted when that one dies
    #[arg(long, value_name = "PID", hide = true)]
    parent: Option<u32>,
}

#[derive(Debug, Subcommand)]
enum Command {
    Up(Box<command::up::UpArgs>),
    Resume(command::resume::ResumeArgs),
    Scale(command::scale::ScaleArgs),
    Stop(command::stop::StopArgs),
    Status(command::status::StatusArgs),
    List(command::list::ListArgs),
    Top(command::top::TopArgs),
    View(command::view::ViewArgs),
    Play(command::play::PlayArgs),
    Logs(command::logs::LogsArgs),
    Compare(command::compare::CompareArgs),
    Eval(command::eval::EvalArgs),
    Report(command::report::ReportArgs),
    Suite(command::suite::SuiteArgs),
    Config(command::config::ConfigArgs),
    Presets(command::presets::PresetsArgs),
    Import(command::import::ImportArgs),
    Kitchens(command::kitchens::KitchensArgs),
    Replay(command::replay::ReplayArgs),
    Export(command::export::ExportArgs),
    Recover(command::recover::RecoverArgs),
    Allow(command::allow::AllowArgs),
    Clean(command::clean::CleanArgs),
    Doctor(command::doctor::DoctorArgs),
    Test(command::test::TestArgs),
    Completions(command::completions::CompletionsArgs),
    Man(command::man::ManArgs),
}

/// The commands, as docs/commands.md groups them.
const GROUPS: [(&str, &str); 6] = [
    ("Before a run", "doctor test presets config"),
    ("Train", "up resume suite import allow"),
    ("Watch and steer", "status list logs compare top view play stop scale clean"),
    ("Evaluate and report", "eval report"),
    ("Recordings and weights", "replay recover export"),
    ("Further", "kitchens completions man"),
];

pub fn main(version: &'static str) -> ExitCode {
    let typed = command::run_ids::with_folders(std::env::args_os(), command::list::RUNS.as_ref());
    let matches = command_line().display_name(output::name::called()).version(version).try_get_matches_from(&typed);
    let line = matches.and_then(|matches| CommandLine::from_arg_matches(&matches));
    let words: Vec<String> = typed.iter().map(|word| word.to_string_lossy().into_owned()).collect();
    let line = line.unwrap_or_else(|error| {
        let error = command::tips::with_tip(error, &command_line(), &words);
        output::name::exit(&error)
    });
    output::terminal::init(line.verbose, Box::new(output::events::LogLines));
    // Before any child is started: it inherits the limit.
    wire::descriptors::raise_limit();
    let done = |()| ExitCode::SUCCESS;
    let followed = line.parent.map_or(Ok(()), |parent| run::lifeline::follow(parent, Signal::INT));
    let result = followed.and_then(|()| demand_place()).and_then(|()| match &line.command {
        Command::Up(args) => command::up::run(args),
        Command::Resume(args) => command::resume::run(args),
        Command::Scale(args) => command::scale::run(args).map(done),
        Command::Stop(args) => command::stop::run(args).map(done),
        Command::Status(args) => command::status::run(args).map(done),
        Command::List(args) => command::list::run(args).map(done),
        Command::Top(args) => command::top::run(args).map(done),
        Command::View(args) => command::view::run(args).map(done),
        Command::Play(args) => command::play::run(args).map(done),
        Command::Logs(args) => command::logs::run(args).map(done),
        Command::Compare(args) => command::compare::run(args).map(done),
        Command::Eval(args) => command::eval::run(args),
        Command::Report(args) => command::report::run(args).map(done),
        Command::Suite(args) => command::suite::run(args),
        Command::Config(args) => command::config::run(args).map(done),
        Command::Presets(args) => command::presets::run(args).map(done),
        Command::Import(args) => command::import::run(args).map(done),
        Command::Kitchens(args) => command::kitchens::run(args),
        Command::Replay(args) => command::replay::run(args),
        Command::Export(args) => command::export::run(args),
        Command::Recover(args) => command::recover::run(args),
        Command::Allow(args) => command::allow::run(args).map(done),
        Command::Clean(args) => command::clean::run(args).map(done),
        Command::Doctor(args) => command::doctor::run(args),
        Command::Test(args) => command::test::run(args),
        Command::Completions(args) => command::completions::run(args, CommandLine::command()).map(done),
        Command::Man(args) => command::man::run(args, CommandLine::command()).map(done),
    });
    let result = result.and_then(|code| output::terminal::demand_written().map(|()| code));
    result.unwrap_or_else(|error| {
        output::terminal::note(&format!("error: {}", command::tips::told(&error)));
        ExitCode::from(if wrong::is_wrong(&error) { 2 } else { 1 })
    })
}

/// As declared; and a negative number is a value, which the option refuses with its range, not an option.
fn command_line() -> clap::Command {
    let takes_numbers = |argument: clap::Arg| {
        let takes_value = argument.get_action().takes_values();
        if takes_value { argument.allow_negative_numbers(true) } else { argument }
    };
    let line = CommandLine::command().mut_subcommands(|command| command.mut_args(takes_numbers));
    let of = |name: &str| {
        let about = line.find_subcommand(name).and_then(clap::Command::get_about).map(ToString::to_string);
        beside(&format!("  {name:13}"), &about.unwrap_or_default(), output::terminal::width()).join("\n") + "\n"
    };
    let list = GROUPS.map(|(heading, names)| format!("{heading}:\n{}\n", names.split(' ').map(of).collect::<String>()));
    let [before, after] = ["{about-with-newline}\n{usage-heading} {usage}\n\n", "Options:\n{options}{after-help}"];
    line.help_template([before, &list.concat(), after].concat())
}

/// Refuses a current folder that was removed: libraries and children would fail in it for reasons that hide this one.
fn demand_place() -> anyhow::Result<()> {
    std::env::current_dir().map(drop).context("the current folder cannot be used: change to another one")
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;
    use proto::run_folder::RunFolder;
    use std::path::Path;

    #[test]
    fn a_wrong_preset_ends_as_a_wrong_option_does() {
        let unknown = proto::config::Config::resolve("demmo", None).unwrap_err();
        assert!(wrong::is_wrong(&anyhow::Error::from(unknown).context("a suite")));
        assert!(!wrong::is_wrong(&anyhow::anyhow!("the disk is full")));
        let unreadable = |cause: std::io::ErrorKind| {
            let path = "a.toml".into();
            wrong::is_wrong(&proto::config::ConfigError::Unreadable { path, cause: cause.into() }.into())
        };
        assert!(unreadable(std::io::ErrorKind::NotFound));
        assert!(!unreadable(std::io::ErrorKind::StaleNetworkFileHandle));
    }

    #[test]
    fn the_help_has_each_command_once() {
        let mut grouped: Vec<&str> = GROUPS.iter().flat_map(|(_, names)| names.split(' ')).collect();
        grouped.sort_unstable();
        let line = command_line();
        let mut all: Vec<&str> = line.get_subcommands().map(clap::Command::get_name).collect();
        all.sort_unstable();
        assert_eq!(grouped, all);
        let help = command_line().render_help().to_string();
        let first = "Before a run:\n  doctor       Check";
        assert!(help.contains(first) && help.contains("\n\nOptions:\n  -v, --verbose"), "{help}");
        assert!(help.contains("Exit status: 0 when all went well"), "{help}");
    }

    /// Clap would break longer examples, and would break again what was broken by hand.
    #[test]
    fn no_line_of_an_example_is_wrapped_and_no_text_is_wrapped_by_hand() {
        for command in command_line().get_subcommands() {
            let text = command.get_after_help().map(ToString::to_string).unwrap_or_default();
            let lines: Vec<&str> = text.lines().collect();
            let is_text = |line: &str| !line.is_empty() && !line.starts_with(' ') && !line.ends_with(':');
            let whole = lines.array_windows().all(|[line, next]| !(is_text(line) && is_text(next)));
            assert!(whole, "{}: {text}", command.get_name());
            // A program in Python cannot be broken.
            let is_long = |line: &&&str| line.starts_with("  ") && line.len() > 80 && !line.starts_with("  python3 -c");
            assert_eq!(lines.iter().filter(is_long).collect::<Vec<_>>(), [""; 0].iter().collect::<Vec<_>>());
        }
    }

    #[test]
    fn the_viewer_that_a_run_starts_is_a_command_of_ours() {
        let command = command::up::viewer(Path::new("orchestrator"), &RunFolder::new("runs/a"));
        let words = std::iter::once(command.get_program()).chain(command.get_args());
        let line = CommandLine::try_parse_from(words).unwrap();
        assert!(line.parent.is_some() && matches!(line.command, Command::View(_)));
    }
}
