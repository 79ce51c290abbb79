//! How a configuration comes about: from defaults, a preset, a file and single settings, or from a run folder.

use super::error::{self, ConfigError};
use super::place::{key_at, line_of, with_range};
use super::remedy::explained;
use super::setting::{Setting, ending_in};
use super::{CarriedGoal, Config, preset, presets};
use crate::bounded;
use crate::digest::sha256;
use crate::run_folder::{Item, RolloutName, RunFolder};
use crate::shell::quoted;
use std::path::Path;
use toml::Table;

impl Config {
    /// Defaults, overlaid by a preset, overlaid by a TOML file if one is given; validated.
    pub fn resolve(preset: &str, file: Option<&Path>) -> Result<Self, ConfigError> {
        Self::resolve_set(preset, file, &[])
    }

    /// The same, overlaid by single settings, in their order.
    pub fn resolve_set(preset: &str, file: Option<&Path>, settings: &[Setting]) -> Result<Self, ConfigError> {
        let file = read(file)?;
        let overlay = file.as_ref().map(|(text, origin)| (text.as_str(), origin.as_str()));
        Self::build(preset, overlay, settings).map_err(|error| placed(error, overlay, settings))
    }

    /// This configuration with a file's keys and single settings over it. Whether they go together is not judged.
    pub fn overlaid(&self, file: Option<&Path>, settings: &[Setting]) -> Result<Self, ConfigError> {
        let file = read(file)?;
        let overlay = file.as_ref().map(|(text, origin)| (text.as_str(), origin.as_str()));
        Self::lay_over(self.to_table(), overlay, settings)
    }

    /// A preset with an overlay as TOML text, and the overlay's name in errors.
    pub fn resolve_with(preset: &str, overlay: Option<(&str, &str)>) -> Result<Self, ConfigError> {
        Self::build(preset, overlay, &[])
    }

    fn build(preset: &str, overlay: Option<(&str, &str)>, settings: &[Setting]) -> Result<Self, ConfigError> {
        let mut config = Self::lay_over(presets::merged(preset)?, overlay, settings)?;
        preset.clone_into(&mut config.preset);
        for (key, present) in [("from", config.from.is_some()), ("evaluation", config.evaluation.is_some())] {
            if present {
                return Err(ConfigError::OutOfRange {
                    place: "configuration".to_owned(),
                    key,
                    value: "{ ... }".to_owned(),
                    problem: "is written by `orchestrator up --from` or `orchestrator eval`, not by hand",
                });
            }
        }
        config.validate()?;
        Ok(config)
    }

    fn lay_over(mut value: Table, overlay: Option<(&str, &str)>, settings: &[Setting]) -> Result<Self, ConfigError> {
        if let Some((text, origin)) = overlay {
            // Parsed on its own first: this is what finds an unknown key with its line.
            parse_named(text, origin)?;
            preset::overlay(&mut value, error::parse(text, origin)?);
        }
        for setting in settings {
            setting.lay_over(&mut value);
        }
        let mut config: Self = value.try_into().map_err(|cause: toml::de::Error| ConfigError::Invalid {
            origin: "the configuration".to_owned(),
            line: 0,
            problem: cause.message().to_owned(),
        })?;
        config.complete_weights();
        Ok(config)
    }

    /// The configuration of a run, or of an evaluation, from its folder.
    pub fn of_run(run: &RunFolder) -> Result<Self, ConfigError> {
        let path = run.config();
        let read = match run.read_text(&path) {
            Ok(text) => {
                let origin = path.display().to_string();
                let declared = error::parse::<Self>(&text, &origin).and_then(|config| config.declare_task_of(run));
                declared.and_then(|()| Self::from_toml(&text, &origin))
            }
            Err(cause) => Err(ConfigError::Unreadable { path, cause }),
        };
        read.map_err(|cause| {
            if !run.checkpoints().is_dir() {
                return cause;
            }
            let (of, out) = (quoted(run.root()), quoted(run.config()));
            let remedy = match Self::saved_under(run) {
                Some(_) => format!(": `orchestrator config --of {of} --out {out}`"),
                None => " go on with the version that began the run, which `run.toml` names".to_owned(),
            };
            ConfigError::OfRun { cause: Box::new(cause), remedy }
        })
    }

    /// The configuration of the newest checkpoint of a run that holds one which this version reads.
    pub fn saved_under(run: &RunFolder) -> Option<Self> {
        let manifests = run.list(&run.checkpoints()).ok()?.into_iter().rev();
        let mut manifests = manifests.filter(|item| RolloutName::Manifest.rollout_of(&item.path).is_some());
        manifests.find_map(|Item { path, .. }| {
            let manifest: serde_json::Value = serde_json::from_str(&run.read_text(&path).ok()?).ok()?;
            let (config, of) = (manifest["config"].as_str()?, manifest["run"].as_str().unwrap_or_default());
            let is_own = of.is_empty() || run.id().is_none_or(|id| id == of);
            let is_whole = manifest["config_sha256"] == sha256(config.as_bytes());
            Self::from_toml(config, "").ok().filter(|_| is_own && is_whole)
        })
    }

    /// Reads a configuration that [`Config::to_toml`] wrote, whenever that was.
    pub fn from_toml(text: &str, origin: &str) -> Result<Self, ConfigError> {
        let mut config: Self = error::parse(text, origin)?;
        config.restore_the_past(&error::parse(text, origin)?);
        config.complete_weights();
        config.validate()?;
        Ok(config)
    }

    /// A stored configuration was written whole, so a key that it lacks did not exist yet. It keeps the behaviour of
    /// that time, because the default may have changed.
    fn restore_the_past(&mut self, written: &Table) {
        let lacks = |table: &str, key: &str| written.get(table).and_then(|table| table.get(key)).is_none();
        if lacks("network", "carried_goal") {
            self.network.carried_goal = CarriedGoal::ObjectToGoal;
        }
        if lacks("ppo", "learning_rate_frames") {
            self.ppo.learning_rate_frames = 0;
        }
    }

    /// The whole configuration as TOML, every default included.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("plain numbers, strings and tables always serialise")
    }
}

/// A user's file. A value of the wrong type is named by its key, and a key without its table by that with it.
fn parse_named(text: &str, origin: &str) -> Result<Config, ConfigError> {
    error::parse::<Config>(text, origin).map_err(|wrong| match wrong {
        ConfigError::UnknownKey { origin, line, key, nearest } => {
            let is_without_table = toml::from_str::<Table>(text).is_ok_and(|table| table.contains_key(&key));
            let ending = if is_without_table { ending_in(&key) } else { None };
            ConfigError::UnknownKey { origin, line, key, nearest: ending.or(nearest) }
        }
        ConfigError::Invalid { origin, line, problem } => {
            let span = toml::from_str::<Config>(text).err().and_then(|error| error.span());
            let problem = match span.and_then(|span| Some((key_at(text, span.start)?, text.get(span)?))) {
                Some((key, written)) => {
                    let said = explained(&key, written, with_range(&key, problem));
                    if said.starts_with('`') { said } else { format!("{key}: {said}") }
                }
                None => problem,
            };
            ConfigError::Invalid { origin, line, problem }
        }
        other => other,
    })
}

/// A value outside of its range with its place in the file, if that is where it is set.
fn placed(error: ConfigError, file: Option<(&str, &str)>, settings: &[Setting]) -> ConfigError {
    match (error, file) {
        (ConfigError::OutOfRange { place, key, value, problem }, Some((text, origin))) => {
            let line = line_of(text, key).filter(|_| !settings.iter().any(|setting| setting.sets(key)));
            let place = line.map_or(place, |line| format!("{origin}:{line}"));
            ConfigError::OutOfRange { place, key, value, problem }
        }
        (error, _) => error,
    }
}

/// The text of a user's file, and its name in errors.
fn read(file: Option<&Path>) -> Result<Option<(String, String)>, ConfigError> {
    let unreadable = |path: &Path, cause| ConfigError::Unreadable { path: path.to_path_buf(), cause };
    let read = |path: &Path| bounded::read_text(path).map_err(|cause| unreadable(path, cause));
    file.map(|path| Ok((read(path)?, path.display().to_string()))).transpose()
}
