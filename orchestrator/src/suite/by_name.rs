//! A suite by its name: a file, or one of those that are built in; and what was probably meant by a name of neither.

use anyhow::{Context, Result, ensure};
use proto::bounded;
use proto::config::presets;
use proto::likeness::nearest;
use proto::shell::quoted;
use std::path::Path;

/// The suites that this program has in itself, by name: where there is no checkout.
pub const BUILT_IN: [(&str, &str); 7] = [
    ("ablations", include_str!("../../../suites/ablations.toml")),
    ("kitchens", include_str!("../../../suites/kitchens.toml")),
    ("paper", include_str!("../../../suites/paper.toml")),
    ("recipe", include_str!("../../../suites/recipe.toml")),
    ("seeds", include_str!("../../../suites/seeds.toml")),
    ("short", include_str!("../../../suites/short.toml")),
    ("two-seeds", include_str!("../../../suites/two-seeds.toml")),
];

/// The text of a file, or of a built-in suite where only its name is given.
pub fn text(path: &Path) -> Result<String> {
    if let Some((_, text)) = BUILT_IN.iter().find(|(name, _)| Path::new(name) == path && !path.is_file()) {
        return Ok((*text).to_owned());
    }
    ensure!(path.exists(), not_there(path));
    let own = path.join("suite.toml");
    ensure!(
        !own.is_file(),
        "{} is the folder of a suite: `orchestrator suite {} --out {}` goes on with it",
        path.display(),
        quoted(&own),
        quoted(path)
    );
    ensure!(!path.is_dir(), "{} is a folder: name the file of a suite in it", path.display());
    bounded::read_text(path).with_context(|| format!("cannot read suite {}", path.display()))
}

/// What is said of a file that is not there, with what was probably meant: a preset, a file beside it, or a built-in suite.
fn not_there(path: &Path) -> String {
    let (shown, stem) = (path.to_string_lossy(), path.file_stem().unwrap_or_default().to_string_lossy());
    let presets = || presets().iter().map(|preset| preset.name.as_str());
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let beside = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|file| file.path());
    let beside = beside.filter(|file| file.extension().is_some_and(|ending| ending == "toml"));
    let beside: Vec<String> = beside.filter_map(|file| Some(file.file_name()?.to_str()?.to_owned())).collect();
    let file = path.file_name().and_then(|file| nearest(&file.to_string_lossy(), beside.iter().map(String::as_str)));
    let file = file.map(|file| path.with_file_name(file).display().to_string());
    let suite = || file.or_else(|| nearest(&stem, BUILT_IN.iter().map(|(name, _)| *name)));
    let is_suite = BUILT_IN.iter().any(|(name, _)| *name == stem);
    let preset = presets().find(|preset| *preset == stem && !is_suite).map(str::to_owned);
    let meant = preset.is_none().then(suite).flatten();
    let tip = match (&meant, preset.or_else(|| nearest(&stem, presets()))) {
        (None, Some(preset)) => format!("; `orchestrator up --preset {preset}` trains a preset"),
        (meant, _) => meant.as_ref().map_or_else(String::new, |meant| format!("; did you mean `{meant}`?")),
    };
    let built_in = BUILT_IN.map(|(name, _)| name).join(", ");
    format!(
        "{shown} is no file, and no built-in suite ({built_in}): a suite is a TOML file (`orchestrator suite --help` shows \
         one){tip}"
    )
}
