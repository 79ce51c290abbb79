use crate::command::choice::of_file;
use crate::output::format::counted;
use crate::output::terminal;
use crate::wrong::demand;
use anyhow::Result;
use proto::exit::EXIT_INCOMPLETE;
use proto::run_folder::RunFolder;
use recording::repair::{Repair, repair};
use std::path::PathBuf;
use std::process::ExitCode;

/// Repair a recording that was cut off or damaged (by a kill, a full disk, a power cut).
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Everything that can be read is kept: messages also behind damage and without indexes, profile, library, \
metadata, attachments and private records. What was lost, or may be wrong, is printed \
and stored in the new file's metadata.

Exit status: 0 if the file is complete or nothing was lost, 6 if something was lost or may be wrong, 1 on failure."
)]
pub struct RecoverArgs {
    /// The recording.
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Write the repaired recording here and leave FILE as it is. Without it FILE is replaced and the old one kept as
    /// FILE.cut.
    #[arg(short, long, value_name = "OUT")]
    output: Option<PathBuf>,
}

pub fn run(args: &RecoverArgs) -> Result<ExitCode> {
    let file = args.file.display();
    demand!(args.file.exists(), "{file} does not exist: name a recording, of a run a file in RUN/recordings");
    demand!(
        !args.file.is_dir(),
        "{file} is a folder: name a recording, of a run a file in {}",
        RunFolder::new(&args.file).recordings().display()
    );
    match repair(&args.file, args.output.as_deref()).map_err(of_file)? {
        Repair::NotNeeded { messages } => {
            terminal::out(&format!("{file} is complete ({}): nothing to do", counted(messages, "message")));
            Ok(ExitCode::SUCCESS)
        }
        Repair::Repaired { repaired, kept, extent } => {
            let (messages, outcome) = (counted(extent.messages, "message"), extent.account.outcome());
            terminal::out(&format!("{}: {messages} recovered, {outcome}", repaired.display()));
            for line in extent.account.lines() {
                terminal::out(&format!("  {line}"));
            }
            if let Some(kept) = kept {
                terminal::out(&format!("the old file is kept as {}", kept.display()));
            }
            Ok(if extent.is_incomplete() { ExitCode::from(EXIT_INCOMPLETE as u8) } else { ExitCode::SUCCESS })
        }
    }
}
