use crate::output::table::beside;
use crate::output::terminal;
use anyhow::Result;
use proto::config::{Preset, presets};
use serde_json::json;

/// List the presets
#[derive(Debug, clap::Args)]
pub struct PresetsArgs {
    /// Print a JSON array of objects with `name` and `summary`
    #[arg(long)]
    json: bool,
}

pub fn run(args: &PresetsArgs) -> Result<()> {
    if args.json {
        let object = |preset: &Preset| json!({ "name": preset.name, "summary": preset.summary });
        return Ok(terminal::out_json(&presets().iter().map(object).collect::<Vec<_>>())?);
    }
    for group in presets().chunk_by(|one, next| heading(&one.name) == heading(&next.name)) {
        terminal::out(heading(&group[0].name));
        let width = group.iter().map(|preset| preset.name.len()).max().unwrap_or_default();
        for preset in group {
            let head = format!("  {:width$}  ", preset.name);
            for line in beside(&head, &preset.summary, terminal::width()) {
                terminal::out(&line);
            }
        }
    }
    Ok(())
}

/// What a preset is for, by the beginning of its name.
fn heading(name: &str) -> &'static str {
    match name.split('-').next().unwrap_or_default() {
        "demo" | "point" => "To begin with, on a CPU",
        "gym" => "Environments of your own",
        "paper" | "recipe" if !name.ends_with("procedural") => "The whole training, on a GPU",
        "short" => "The same in few frames",
        "recipe" | "procedural" => "In kitchens without end",
        "ablation" => "Rows of the paper: ablations of network and inputs",
        "small" => "Rows of the paper: fewer actions",
        "lambda" | "lagrangian" => "Rows of the paper: the price of a disturbance",
        _ => "Rows of the paper: auxiliary tasks, each with five plans of rewards",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_group_of_presets_stands_together_below_one_heading() {
        let groups = presets().chunk_by(|one, next| heading(&one.name) == heading(&next.name));
        let headings: Vec<_> = groups.map(|group| (heading(&group[0].name), group.len())).collect();
        let mut once = headings.clone();
        once.sort_unstable();
        once.dedup_by_key(|(heading, _)| *heading);
        assert_eq!((once.len(), headings.len()), (9, 9), "{headings:?}");
        assert_eq!(headings[0], ("To begin with, on a CPU", 2));
    }
}
