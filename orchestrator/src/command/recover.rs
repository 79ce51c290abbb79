//! `orchestrator recover`: a whole recording from one that was cut off.

use crate::recording::repair::{Repair, repair};
use crate::showing::format::counted;
use crate::showing::terminal;
use anyhow::Result;
use std::path::PathBuf;

/// Repair a recording that was cut off (by a kill, a full disk, a power cut).
#[derive(Debug, clap::Args)]
pub struct RecoverArgs {
    /// The recording.
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Write the repaired recording here and leave FILE as it is. Without it FILE is replaced and the old one kept as
    /// FILE.cut.
    #[arg(short, long, value_name = "OUT")]
    output: Option<PathBuf>,
}

/// Runs the command.
pub fn run(args: &RecoverArgs) -> Result<()> {
    let file = args.file.display();
    match repair(&args.file, args.output.as_deref())? {
        Repair::NotNeeded { messages } => {
            terminal::out(&format!("{file} is complete ({}): nothing to do", counted(messages, "message")));
        }
        Repair::Repaired { repaired, kept, extent } => {
            terminal::out(&format!("{}: {} recovered", repaired.display(), counted(extent.messages, "message")));
            if let Some(kept) = kept {
                terminal::out(&format!("the old file is kept as {}", kept.display()));
            }
        }
    }
    Ok(())
}
