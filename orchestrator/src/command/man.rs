use crate::output::terminal;
use anyhow::{Context, Result};
use std::path::PathBuf;

/// Print the manual page, or write one for each command
///
/// `make install` puts all of them where `man` looks: then `man orchestrator-up` shows that of `orchestrator up`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  orchestrator man | man -l -                      reads it
  orchestrator man up | man -l -                   reads that of a command
  orchestrator man man1                            writes orchestrator.1, orchestrator-up.1, ... into the folder man1")]
pub struct ManArgs {
    /// A command, to print its page; or a folder for the pages of all, which is made if it is not there [default:
    /// prints the page of `orchestrator`]
    #[arg(value_name = "COMMAND|DIR")]
    folder: Option<PathBuf>,
}

pub fn run(args: &ManArgs, line: clap::Command) -> Result<()> {
    let named = args.folder.as_ref().and_then(|name| line.find_subcommand(name));
    let Some(folder) = args.folder.as_ref().filter(|_| named.is_none()) else {
        let mut page = Vec::new();
        let line = named
            .map_or_else(|| line.clone(), |command| command.clone().display_name(format!("orchestrator-{command}")));
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
