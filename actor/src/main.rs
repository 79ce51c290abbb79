//! The `actor` program: rolls out environments for a learner, re-simulates recordings, shows, proves and measures what
//! it simulates.

mod command;

use anyhow::Result;
use clap::error::ErrorKind;
use clap::{CommandFactory, Parser};
use command::{Command, RolloutArgs};
use engine::whereabouts;
use simulator::scene_file::SceneError;
use std::process::ExitCode;

wire::require_processor!();

/// Simulates kitchens for Stillroom.
///
/// Without a subcommand it is one rollout actor of a run; `orchestrator up` starts it as such.
#[derive(Debug, Parser)]
#[command(version = wire::version!(), args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    rollout: RolloutArgs,
}

/// A command line without a subcommand is the orchestrator's to write.
fn parsed() -> Arguments {
    Arguments::try_parse().unwrap_or_else(|error| {
        let has_no_command = std::env::args().nth(1).is_none_or(|word| word.starts_with('-'));
        match error.kind() {
            kind @ (ErrorKind::MissingRequiredArgument | ErrorKind::UnknownArgument) if has_no_command => {
                let meant = "`orchestrator up` starts it; `actor --help` lists what else it does";
                Arguments::command().error(kind, meant).exit()
            }
            _ => error.exit(),
        }
    })
}

fn main() -> ExitCode {
    let arguments = parsed();
    let is_command = arguments.command.is_some();
    wire::logging::to_stderr();
    whereabouts::name_it_in_panics();
    match run(arguments) {
        Ok(()) => ExitCode::SUCCESS,
        // The reader of a pipe has gone: as other programs do, a command ends.
        Err(error) if is_command && error.chain().any(is_unread) => ExitCode::SUCCESS,
        Err(error) => {
            let place = whereabouts::here().map(|here| format!(" ({here})")).unwrap_or_default();
            // A command's reader is a person, a rollout's a log.
            if is_command {
                eprintln!("error: {error:#}{place}");
            } else {
                tracing::error!("{error:#}{place}");
            }
            // As of a command line that cannot be read: the scene that it names is wrong.
            let is_wrong = is_command && error.chain().any(<dyn std::error::Error>::is::<SceneError>);
            if is_wrong { ExitCode::from(2) } else { ExitCode::FAILURE }
        }
    }
}

fn is_unread(cause: &(dyn std::error::Error + 'static)) -> bool {
    cause.downcast_ref::<std::io::Error>().is_some_and(|error| error.kind() == std::io::ErrorKind::BrokenPipe)
}

fn run(arguments: Arguments) -> Result<()> {
    match &arguments.command {
        Some(command) => command::run(command),
        None => arguments.rollout.run(),
    }
}
