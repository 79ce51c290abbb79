use crate::output::terminal;
use anyhow::{Context, Result};
use clap_mangen::Man;
use std::path::PathBuf;

/// Write the manual pages, one for each command
///
/// `make install` puts all of them where `man` looks: then `man orchestrator-up` shows that of `orchestrator up`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:
  # writes orchestrator.1, orchestrator-up.1, ...
  orchestrator man man1/

`orchestrator help up` shows that of `up`.")]
pub struct ManArgs {
    /// The folder to write, which is made
    #[arg(value_name = "DIR")]
    folder: PathBuf,
}

pub fn run(args: &ManArgs, line: clap::Command) -> Result<()> {
    // Its commands get their whole names.
    let mut line = line.disable_help_subcommand(true);
    line.build();
    let source = format!("{} {}", line.get_name(), line.get_version().unwrap_or_default());
    let folder = &args.folder;
    std::fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
    let mut pages = 0;
    for command in line.get_subcommands().filter(|command| !command.is_hide_set()).chain([&line]) {
        let page = Man::new(command.clone()).source(source.clone());
        page.generate_to(folder).with_context(|| format!("cannot write to {}", folder.display()))?;
        pages += 1;
    }
    terminal::out(&format!("{pages} pages in {}", folder.display()));
    Ok(())
}
