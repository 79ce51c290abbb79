//! `orchestrator man`: manual pages, from the command line's own definition.

use crate::showing::terminal;
use anyhow::{Context, Result};
use std::path::PathBuf;

/// Print the manual page, or write one for each command
///
/// `make install` puts all of them where `man` looks: then `man orchestrator-up` shows that of `orchestrator up`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  orchestrator man | man -l -                      reads it
  orchestrator man man1                            writes orchestrator.1, orchestrator-up.1, ... into the folder man1")]
pub struct ManArgs {
    /// Folder for the pages of all commands; it is made if it is not there [default: prints the page of `orchestrator`]
    #[arg(value_name = "DIR")]
    folder: Option<PathBuf>,
}

/// Runs the command for this command line.
pub fn run(args: &ManArgs, line: clap::Command) -> Result<()> {
    let Some(folder) = &args.folder else {
        let mut page = Vec::new();
        clap_mangen::Man::new(line).render(&mut page).context("the manual page")?;
        let page = String::from_utf8(page).context("the manual page is no text")?;
        terminal::out(page.trim_end());
        return Ok(());
    };
    let pages = line.get_subcommands().filter(|command| !command.is_hide_set()).count() + 1;
    std::fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
    clap_mangen::generate_to(line, folder).with_context(|| format!("cannot write to {}", folder.display()))?;
    terminal::out(&format!("{pages} pages in {}", folder.display()));
    Ok(())
}
