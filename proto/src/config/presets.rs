//! All presets. Those with reasons of their own are TOML files beside the code; the rows of the paper's tables are
//! composed in [`experiment`].

use super::error::{ConfigError, parse};
use super::experiment;
use super::preset::{Preset, overlay};
use crate::likeness::nearest;
use std::sync::LazyLock;

/// Presets with a file of their own.
const FILES: &[(&str, &str, &str)] = &[
    (
        "demo",
        "both stages in minutes on two CPU cores: small encoder, episodes that begin near the target",
        include_str!("../../presets/demo.toml"),
    ),
    (
        "point-nav-demo",
        "PointNav in minutes on two CPU cores: drive to a point near the start, by depth and relative goal",
        include_str!("../../presets/point-nav-demo.toml"),
    ),
    (
        "gym",
        "tasks of numbers, such as CartPole: two layers of 64, no memory, the constants of CleanRL's ppo.py",
        include_str!("../../presets/gym.toml"),
    ),
    (
        "paper",
        "the paper's exact shape: 19 environments, T = 200, resnet, 20M + 25M frames",
        include_str!("../../presets/paper.toml"),
    ),
    (
        "recipe",
        "where to begin on a GPU: 20M + 25M frames, constants that learn from few frames, a GPU's shape",
        include_str!("../../presets/recipe.toml"),
    ),
    (
        "short-two-stage",
        "the curriculum in 5M + 5M frames, tuned for few frames: minutes on one GPU (RESULTS.md)",
        include_str!("../../presets/short-two-stage.toml"),
    ),
    (
        "short-r-only",
        "beside short-two-stage: reward r alone, 10M frames",
        include_str!("../../presets/short-r-only.toml"),
    ),
    (
        "short-scratch",
        "beside short-two-stage: reward r′ from the first frame, 10M frames",
        include_str!("../../presets/short-scratch.toml"),
    ),
    (
        "recipe-procedural",
        "recipe in 1,000 procedural kitchens instead of the 19",
        include_str!("../../presets/recipe-procedural.toml"),
    ),
    (
        "procedural-scratch",
        "recipe-procedural with r′ from the first frame: the best of all that was run (RESULTS.md)",
        include_str!("../../presets/procedural-scratch.toml"),
    ),
    (
        "procedural-100",
        "short-two-stage in 100 procedural kitchens instead of the 19",
        include_str!("../../presets/procedural-100.toml"),
    ),
    (
        "procedural-1000",
        "short-two-stage in 1,000 procedural kitchens",
        include_str!("../../presets/procedural-1000.toml"),
    ),
    (
        "procedural-10000",
        "short-two-stage in 10,000 procedural kitchens",
        include_str!("../../presets/procedural-10000.toml"),
    ),
];

/// All presets: those with a file, then every row of the paper's tables.
pub fn presets() -> &'static [Preset] {
    static PRESETS: LazyLock<Vec<Preset>> = LazyLock::new(|| {
        let files = FILES.iter().map(|&(name, summary, text)| Preset {
            name: name.to_owned(),
            summary: summary.to_owned(),
            text: text.into(),
        });
        files.chain(experiment::all()).collect()
    });
    &PRESETS
}

/// The preset as a TOML table, what it extends included.
pub(super) fn merged(name: &str) -> Result<toml::Table, ConfigError> {
    let names = || presets().iter().map(|preset| preset.name.as_str());
    let preset = presets()
        .iter()
        .find(|preset| preset.name == name)
        .ok_or_else(|| ConfigError::UnknownPreset { name: name.to_owned(), nearest: nearest(name, names()) })?;
    let mut table: toml::Table = parse(&preset.text, &format!("preset {name}"))?;
    let Some(base) = table.remove("extends") else { return Ok(table) };
    let base = base.as_str().map(str::to_owned).unwrap_or_default();
    let mut result = merged(&base)?;
    overlay(&mut result, table);
    Ok(result)
}

#[cfg(test)]
mod tests {
    use super::super::{CarriedGoal, Config};
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn every_preset_resolves_and_survives_a_round_trip() {
        let mut names = BTreeSet::new();
        for preset in presets() {
            assert!(names.insert(&preset.name), "two presets are called {}", preset.name);
            let config = Config::resolve(&preset.name, None).unwrap();
            assert_eq!(config.preset, preset.name);
            assert_eq!(Config::from_toml(&config.to_toml(), "round trip").unwrap(), config);
        }
    }

    #[test]
    fn the_paper_preset_is_the_defaults() {
        assert_eq!(Config::resolve("paper", None).unwrap(), Config::default());
    }

    /// Runs from before these keys had the other sign and a rate that fell over the stage, whatever their preset is
    /// now.
    #[test]
    fn a_stored_configuration_without_a_newer_key_keeps_what_held_then() {
        for preset in ["paper", "short-two-stage"] {
            let config = Config::resolve(preset, None).unwrap();
            let text = config.to_toml();
            let newer = |line: &&str| !line.starts_with("carried_goal") && !line.starts_with("learning_rate_frames");
            let older: Vec<&str> = text.lines().filter(newer).collect();
            assert_eq!(older.len() + 2, text.lines().count());
            let read = Config::from_toml(&older.join("\n"), "an older run").unwrap();
            let mut then = config;
            then.network.carried_goal = CarriedGoal::ObjectToGoal;
            then.ppo.learning_rate_frames = 0;
            assert_eq!(read, then);
            // From now on they are written down.
            assert_eq!(Config::from_toml(&read.to_toml(), "the same run").unwrap(), then);
        }
    }
}
