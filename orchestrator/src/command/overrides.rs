//! Options that `up`, `import`, `config` and `doctor` share: what the user lays over a preset. Each lies over those
//! before it: preset, `--config`, `--set`, the other flags.

use anyhow::Result;
use clap::Args;
use proto::bounded;
use proto::config::{self, Config, ConfigError, Setting};
use proto::device::Torch;
use proto::stage::scale_to;
use proto::task::Spec;
use std::path::PathBuf;

/// What the user lays over a preset.
#[derive(Debug, Clone, Default, Args)]
pub struct Overrides {
    /// TOML file whose keys replace the preset's (`orchestrator config` shows them all)
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// One key of the configuration, for example ppo.learning_rate=1e-3; repeat it for more. The value is TOML, a
    /// single word can do without quotes. It wins over preset and --config; the flags below win over it
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<Setting>,
    /// Actor processes; actor i simulates training kitchen i, beyond 19 kitchens repeat [default: the preset's; 19 in most, 38 in recipe]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=512))]
    pub actors: Option<u32>,
    /// Learner processes; actors are divided among them, on CUDA each has a device of its own [default: the preset's, 1]
    #[arg(long, value_name = "R", value_parser = clap::value_parser!(u32).range(1..=512))]
    pub learners: Option<u32>,
    /// Environments in each actor
    #[arg(long, value_name = "E", value_parser = clap::value_parser!(u32).range(1..=256))]
    pub envs_per_actor: Option<u32>,
    /// Seed of everything random
    #[arg(long, value_name = "S", value_parser = one_seed)]
    pub seed: Option<u64>,
    /// Frames of the whole run (also as 2M or 2e6); all stages are scaled in proportion
    #[arg(long, value_name = "F", value_parser = frames)]
    pub frames: Option<u64>,
}

impl Overrides {
    pub fn resolve(&self, preset: &str) -> Result<Config> {
        let config = self.scaled(Config::resolve_set(preset, self.config.as_deref(), &self.settings()?)?)?;
        config.validate()?;
        Ok(config)
    }

    /// `base` with what the user gave. Whether it goes together is not judged.
    pub fn over(&self, base: &Config) -> Result<Config> {
        self.scaled(base.overlaid(self.config.as_deref(), &self.settings()?)?)
    }

    /// Environments in each actor, if the user sets them in whatever way: then they do not depend on what was set before.
    pub fn environments_per_actor(&self) -> Result<Option<u32>> {
        let over = |before: u32| {
            let mut base = Config::default();
            base.actors.environments_per_actor = before;
            let set = base.overlaid(self.config.as_deref(), &self.settings()?)?;
            anyhow::Ok(set.actors.environments_per_actor)
        };
        let [one, other] = [over(1)?, over(2)?];
        Ok((one == other).then_some(one))
    }

    /// What the user sets over the defaults, in whatever way; whether it can be is judged when all is known.
    pub fn over_defaults(&self) -> Result<Config> {
        Ok(Config::default().overlaid(self.config.as_deref(), &self.settings()?)?)
    }

    /// The built-in task that the user sets, in whatever way.
    pub fn built_in_task(&self) -> Result<Option<String>> {
        let over = |before: &str| {
            let base = Config { task: before.to_owned(), ..Config::default() };
            anyhow::Ok(base.overlaid(self.config.as_deref(), &self.settings()?)?.task)
        };
        let [one, other] = [over("arm_point_nav")?, over("point_nav")?];
        Ok((one == other && Spec::built_in().iter().any(|spec| spec.name == one)).then_some(one))
    }

    /// Flags are settings, too: whether one can be is judged when all are known.
    fn settings(&self) -> Result<Vec<Setting>> {
        let mut settings = self.set.clone();
        for (key, value) in [
            ("actors.count", self.actors),
            ("learner.count", self.learners),
            ("actors.environments_per_actor", self.envs_per_actor),
        ] {
            settings.extend(value.map(|value| Setting::new(key, i64::from(value).into())).transpose()?);
        }
        Ok(settings)
    }

    fn scaled(&self, mut config: Config) -> Result<Config> {
        if let Some(seed) = self.seed {
            config.seed = seed;
        }
        if let Some(frames) = self.frames {
            config.stages = scale_to(&config.stages, frames)?;
        }
        Ok(config)
    }

    /// The preset to take: the one `asked` for, else the one that the user's file names, else `default`, which is
    /// only computed then.
    pub fn preset<'a>(&self, asked: Option<&str>, default: impl FnOnce() -> Result<&'a str>) -> Result<String> {
        if let Some(asked) = asked {
            return Ok(asked.to_owned());
        }
        match self.preset_in_file()? {
            Some(named) => Ok(named),
            None => Ok(default()?.to_owned()),
        }
    }

    fn preset_in_file(&self) -> Result<Option<String>> {
        let Some(path) = &self.config else { return Ok(None) };
        let unreadable = |cause| ConfigError::Unreadable { path: path.clone(), cause };
        let text = bounded::read_text(path).map_err(unreadable)?;
        // A broken file is reported with its line when it is read in earnest.
        let table: Option<toml::Table> = toml::from_str(&text).ok();
        Ok(table.and_then(|table| Some(table.get("preset")?.as_str()?.to_owned())))
    }
}

fn one_seed(text: &str) -> Result<u64, String> {
    if text.contains(',') {
        return Err(format!("a run has one seed; `orchestrator suite FILE --seed {text}` trains a run with each"));
    }
    seed(text)
}

/// Seeds are numbers that TOML, in which configurations are written, can hold.
pub fn seed(text: &str) -> Result<u64, String> {
    let seed = text.parse().ok().filter(|&seed| i64::try_from(seed).is_ok());
    seed.ok_or_else(|| format!("a seed is a whole number from 0 to {}", i64::MAX))
}

pub fn frames(text: &str) -> Result<u64, String> {
    config::frames_in(text)
        .ok_or_else(|| "expected a whole number of frames from 1 on: 2000000, 2_000_000, 2M or 2e6".into())
}

pub fn default_preset(torch: &Torch) -> &'static str {
    if torch.has_cuda() { "recipe" } else { "demo" }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_read_as_people_write_them() {
        for (text, expected) in [("7", 7), ("1_000", 1000), ("1e6", 1_000_000), ("2M", 2_000_000), ("1.5k", 1500)] {
            assert_eq!(frames(text), Ok(expected), "{text}");
        }
        for text in ["", "0", "-5", "M", "1.5", "1e99", "nan", "inf", "2m", "1e-3", "2MM"] {
            assert!(frames(text).unwrap_err().contains("2M or 2e6"), "{text}");
        }
    }

    #[test]
    fn a_built_in_task_is_found_where_the_user_sets_one() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("mine.toml");
        let of = |set: &[&str], text: &str| {
            std::fs::write(&file, text).unwrap();
            let set = set.iter().map(|one| one.parse().unwrap()).collect();
            Overrides { set, config: Some(file.clone()), ..Overrides::default() }.built_in_task().unwrap()
        };
        assert_eq!(of(&["task=point_nav"], "").as_deref(), Some("point_nav"));
        assert_eq!(of(&[], "task = \"arm_point_nav\"").as_deref(), Some("arm_point_nav"));
        assert_eq!(of(&["task=cart_pole_v1"], "task = \"point_nav\""), None, "as a run's configuration has it");
        assert_eq!(of(&["seed=2"], ""), None);
    }

    #[test]
    fn every_learner_has_actors() {
        let learners = |learners, actors| {
            let overrides = Overrides { learners: Some(learners), actors: Some(actors), ..Overrides::default() };
            overrides.resolve("demo").map(|config| config.learner.count)
        };
        assert_eq!(learners(2, 2).unwrap(), 2);
        assert!(learners(3, 2).unwrap_err().to_string().contains("learner.count"));
        assert_eq!(learners(30, 60).unwrap(), 30, "more than the preset has actors");
    }
}
