use crate::output::terminal;
use anyhow::Result;
use proto::config::presets;

/// List the presets
#[derive(Debug, clap::Args)]
pub struct PresetsArgs {
    /// Print a JSON array of objects with `name` and `summary`
    #[arg(long)]
    json: bool,
}

pub fn run(args: &PresetsArgs) -> Result<()> {
    if args.json {
        let list: Vec<_> = presets()
            .iter()
            .map(|preset| serde_json::json!({ "name": preset.name, "summary": preset.summary }))
            .collect();
        terminal::out_json(&list)?;
        return Ok(());
    }
    let width = presets().iter().map(|preset| preset.name.len()).max().unwrap_or(0);
    for preset in presets() {
        terminal::out(&format!("{:width$}  {}", preset.name, preset.summary));
    }
    Ok(())
}
