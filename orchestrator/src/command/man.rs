use crate::output::terminal;
use anyhow::{Context, Result};
use clap_mangen::Man;
use std::io::IsTerminal;
use std::path::PathBuf;

/// Show the manual page, or write one for each command
///
/// `make install` puts all of them where `man` looks: then `man orchestrator-up` shows that of `orchestrator up`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  orchestrator man up                              that of a command
  orchestrator man up > up.1                       its source
  orchestrator man man1                            writes orchestrator.1, orchestrator-up.1, ... into the folder man1")]
pub struct ManArgs {
    /// A command, to show its page; or a folder for the pages of all, which is made if it is not there [default:
    /// the page of `orchestrator`]
    #[arg(value_name = "COMMAND|DIR")]
    folder: Option<PathBuf>,
}

pub fn run(args: &ManArgs, line: clap::Command) -> Result<()> {
    // Its commands get their whole names.
    let mut line = line.disable_help_subcommand(true);
    line.build();
    let source = format!("{} {}", line.get_name(), line.get_version().unwrap_or_default());
    let page_of = |command: &clap::Command| Man::new(command.clone()).source(source.clone());
    let named = args.folder.as_ref().and_then(|name| line.find_subcommand(name));
    let Some(folder) = args.folder.as_ref().filter(|_| named.is_none()) else {
        let (mut page, command) = (Vec::new(), named.unwrap_or(&line));
        page_of(command).render(&mut page).context("the manual page")?;
        let page = String::from_utf8(page).context("the manual page is no text")?;
        // Nobody reads the source of a page at a terminal.
        let help = std::io::stdout().is_terminal().then(|| command.clone().render_long_help().to_string());
        terminal::out(help.unwrap_or(page).trim_end());
        return Ok(());
    };
    std::fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
    let mut pages = 0;
    for command in line.get_subcommands().filter(|command| !command.is_hide_set()).chain([&line]) {
        page_of(command).generate_to(folder).with_context(|| format!("cannot write to {}", folder.display()))?;
        pages += 1;
    }
    terminal::out(&format!("{pages} pages in {}", folder.display()));
    Ok(())
}
