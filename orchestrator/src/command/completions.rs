use crate::output::{name, terminal};
use anyhow::{Context, Result};
use clap_complete::Shell;

/// Print the completions of this command line for a shell
///
/// `make install` puts those of bash, zsh and fish where these shells look for them.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  # for this shell
  source <(orchestrator completions bash)
  orchestrator completions bash \\
    > ~/.local/share/bash-completion/completions/orchestrator
  # a folder of fpath, before compinit
  orchestrator completions zsh > ~/.zfunc/_orchestrator
  orchestrator completions fish > ~/.config/fish/completions/orchestrator.fish")]
pub struct CompletionsArgs {
    /// The shell
    #[arg(value_enum, value_name = "SHELL")]
    shell: Shell,
}

pub fn run(args: &CompletionsArgs, mut line: clap::Command) -> Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut line, name::called(), &mut script);
    let script = String::from_utf8(script).context("the completions are no text")?;
    terminal::out(script.trim_end());
    Ok(())
}
