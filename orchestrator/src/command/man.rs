use crate::output::terminal;
use crate::wrong::reject;
use anyhow::{Context, Result};
use clap_mangen::Man;
use proto::likeness::nearest;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};

/// Show the manual page, or write one for each command
///
/// `make install` puts all of them where `man` looks: then `man orchestrator-up` shows that of `orchestrator up`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  # that of a command
  orchestrator man up
  # its source
  orchestrator man up > up.1
  # writes orchestrator.1, orchestrator-up.1, ... into the folder man1
  orchestrator man man1/")]
pub struct ManArgs {
    /// A command, to show its page; or a folder for the pages of all, with a slash where it is to be made [default: the
    /// page of `orchestrator`]
    #[arg(value_name = "COMMAND|DIR")]
    folder: Option<PathBuf>,
}

pub fn run(args: &ManArgs, line: clap::Command) -> Result<()> {
    // Its commands get their whole names.
    let mut line = line.disable_help_subcommand(true);
    line.build();
    let source = format!("{} {}", line.get_name(), line.get_version().unwrap_or_default());
    let page_of = |command: &clap::Command| Man::new(command.clone()).source(source.clone());
    let name = args.folder.as_ref().and_then(|name| name.to_str());
    let command = name.map(|name| name.strip_prefix("orchestrator-").unwrap_or(name));
    let named = command.and_then(|name| line.find_subcommand(name));
    if let Some(name) = command.filter(|name| named.is_none() && !name.contains('/') && !Path::new(name).is_dir()) {
        let meant = nearest(name, line.get_subcommands().map(clap::Command::get_name));
        let meant = meant.map_or_else(String::new, |meant| format!(" (did you mean `{meant}`?)"));
        reject!("no command is called `{name}`{meant}; for the pages of all in a new folder type `{name}/`");
    }
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
