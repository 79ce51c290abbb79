//! Single settings, as `--set ppo.learning_rate=1e-3` gives them: any key of the configuration, each judged alone.

use super::Config;
use super::error::{self, ConfigError};
use super::place::with_range;
use super::preset::overlay;
use super::remedy::explained;
use crate::likeness::suggestion;
use std::str::FromStr;
use toml::{Table, Value};

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SettingError {
    #[error("it has no value: expected KEY=VALUE, for example ppo.learning_rate=1e-3")]
    NoValue,
    #[error("`{0}` is no key: expected names with dots between them, for example ppo.learning_rate")]
    NoKey(String),
    #[error("`{0}` is neither TOML nor a single word; quote any other text twice, for example KEY='\"two words\"'")]
    BadValue(String),
    #[error("`{key}` is no setting: use {instead}")]
    SaidElsewhere { key: &'static str, instead: &'static str },
    #[error("unknown key `{key}`{}", suggestion(.nearest.as_deref()))]
    UnknownKey {
        /// The last part of the key that is unknown.
        key: String,
        /// The keys that end so, or the closest valid one.
        nearest: Option<String>,
    },
    #[error("{0}")]
    WrongType(String),
}

/// One key of the configuration with its value. The key exists, and the value is of its type; whether it is in its
/// range can depend on other settings.
#[derive(Debug, Clone, PartialEq)]
pub struct Setting(Table);

impl Setting {
    pub fn new(key: &str, value: Value) -> Result<Self, SettingError> {
        let sound = |name: &str| {
            let letter = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'_' || byte == b'-';
            !name.is_empty() && name.bytes().all(letter)
        };
        if !key.split('.').all(sound) {
            return Err(SettingError::NoKey(key.to_owned()));
        }
        let nested = key.rsplit('.').fold(value, |inner, name| Table::from_iter([(name.to_owned(), inner)]).into());
        let Value::Table(table) = nested else { return Err(SettingError::NoKey(key.to_owned())) };
        check_settings(&table).map_err(|error| match error {
            SettingError::WrongType(problem) => SettingError::WrongType(with_range(key, problem)),
            other => other,
        })?;
        Ok(Self(table))
    }

    /// Whether it sets this dotted key, or a table that it is in.
    pub fn sets(&self, key: &str) -> bool {
        let mut names = key.split('.');
        let mut table = &self.0;
        loop {
            match names.next().map(|name| table.get(name)) {
                Some(Some(Value::Table(inner))) => table = inner,
                Some(found) => return found.is_some(),
                None => return true,
            }
        }
    }

    pub fn lay_over(&self, bottom: &mut Table) {
        overlay(bottom, self.0.clone());
    }
}

impl FromStr for Setting {
    type Err = SettingError;

    fn from_str(text: &str) -> Result<Self, SettingError> {
        let (key, value) = text.split_once('=').ok_or(SettingError::NoValue)?;
        let (key, value) = (key.trim(), value.trim());
        if value.is_empty() {
            return Err(SettingError::NoValue);
        }
        let elsewhere = [
            ("preset", "`--preset`"),
            ("from", "`orchestrator up --from`"),
            ("evaluation", "the command line of `orchestrator eval`"),
        ];
        let first = key.split('.').next().unwrap_or_default();
        if let Some(&(key, instead)) = elsewhere.iter().find(|(key, _)| *key == first) {
            return Err(SettingError::SaidElsewhere { key, instead });
        }
        let counted = key.ends_with("_frames").then(|| frames_in(value)).flatten();
        let counted = counted.map_or_else(|| value.to_owned(), |frames| frames.to_string());
        value_of(&counted).and_then(|value| Self::new(key, value)).map_err(|error| match error {
            SettingError::WrongType(problem) => SettingError::WrongType(explained(key, value, problem)),
            SettingError::BadValue(_) => {
                let said = explained(key, value, String::new());
                if said.is_empty() { error } else { SettingError::WrongType(said) }
            }
            other => other,
        })
    }
}

/// Frames as people write them: 2000000, `2_000_000`, 2M or 2e6; none of what is no whole number from 1 on.
pub fn frames_in(text: &str) -> Option<u64> {
    let plain = text.replace('_', "");
    let (digits, unit) = match plain.char_indices().last() {
        Some((at, 'k' | 'K')) => (&plain[..at], 1e3),
        Some((at, 'M')) => (&plain[..at], 1e6),
        Some((at, 'G')) => (&plain[..at], 1e9),
        _ => (&plain[..], 1.0),
    };
    // Doubles hold all whole numbers up to here.
    let exact = |frames: &f64| frames.fract() == 0.0 && (1.0..=2f64.powi(53)).contains(frames);
    digits.parse::<f64>().ok().map(|number| number * unit).filter(exact).map(|frames| frames as u64)
}

/// The keys whose last part is this name.
pub(super) fn ending_in(name: &str) -> Option<String> {
    fn collect(table: &Table, path: &str, name: &str, found: &mut Vec<String>) {
        for (key, value) in table {
            let path = format!("{path}{key}");
            match value {
                Value::Table(inner) => collect(inner, &format!("{path}."), name, found),
                _ if key == name => found.push(path),
                _ => {}
            }
        }
    }
    let mut found = vec![];
    collect(&Config::default().to_table(), "", name, &mut found);
    (!found.is_empty()).then(|| found.join("` or `"))
}

/// The value as TOML; a bare word that is no TOML is a string.
fn value_of(text: &str) -> Result<Value, SettingError> {
    let text = text.trim();
    let bad = || SettingError::BadValue(text.to_owned());
    if let Ok(mut table) = toml::from_str::<Table>(&format!("value = {text}")) {
        // A second line would be a second key.
        let value = table.remove("value").ok_or_else(bad)?;
        return if table.is_empty() { Ok(value) } else { Err(bad()) };
    }
    let bare = |letter: char| letter.is_alphanumeric() || "_-+./:@~".contains(letter);
    if text.is_empty() || !text.chars().all(bare) {
        return Err(bad());
    }
    Ok(Value::String(text.to_owned()))
}

/// Refuses keys that no configuration has, and values of the wrong type; each value is best judged alone, so that it is
/// clear which one is meant.
pub fn check_settings(table: &Table) -> Result<(), SettingError> {
    let text = toml::to_string(table).map_err(|cause| SettingError::WrongType(cause.to_string()))?;
    match error::parse::<Config>(&text, "settings") {
        Ok(_) => Ok(()),
        Err(ConfigError::UnknownKey { key, nearest, .. }) => {
            let ending = if table.contains_key(&key) { ending_in(&key) } else { None };
            Err(SettingError::UnknownKey { key, nearest: ending.or(nearest) })
        }
        Err(ConfigError::Invalid { problem, .. }) => Err(SettingError::WrongType(problem)),
        Err(other) => Err(SettingError::WrongType(other.to_string())),
    }
}

#[cfg(test)]
mod tests {
    use super::super::{DeviceChoice, Encoder};
    use super::*;

    fn setting(text: &str) -> Setting {
        text.parse().unwrap_or_else(|error| panic!("{text}: {error}"))
    }

    fn problem(text: &str) -> String {
        text.parse::<Setting>().expect_err(text).to_string()
    }

    #[test]
    fn values_are_toml_or_a_bare_word() {
        let settings = [
            "ppo.learning_rate=1e-3",
            "validation.every_frames=1.5M",
            "ppo.learning_rate_frames=1e6",
            " ppo.epochs = 2 ",
            "ppo.normalize_advantages=true",
            "learner.device=cpu",
            "network.encoder=\"cnn\"",
            "scenes=[\"a b/scene.toml\"]",
            "reward.lagrangian={ initial = 2 }",
            "stages=[{ name = \"I\", reward = \"r\", frames = 10 }]",
        ];
        let config = Config::resolve_set("demo", None, &settings.map(setting)).unwrap();
        assert_eq!((config.ppo.learning_rate, config.ppo.epochs, config.ppo.normalize_advantages), (1e-3, 2, true));
        assert_eq!((config.learner.device, config.network.encoder), (DeviceChoice::Cpu, Encoder::Cnn));
        assert_eq!((config.validation.every_frames, config.ppo.learning_rate_frames), (1_500_000, 1_000_000));
        assert_eq!((config.scenes, config.reward.lagrangian.initial), (vec!["a b/scene.toml".to_owned()], 2.0));
        assert_eq!((config.stages.len(), config.stages[0].frames), (1, 10));
    }

    #[test]
    fn settings_lie_over_the_file_and_a_later_one_over_an_earlier() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mine.toml");
        std::fs::write(&path, "[ppo]\nepochs = 2\nclip = 0.3\n").unwrap();
        let settings = [setting("ppo.epochs=3"), setting("ppo.epochs=5")];
        let config = Config::resolve_set("demo", Some(&path), &settings).unwrap();
        let demo = Config::resolve("demo", None).unwrap();
        assert_eq!((config.ppo.epochs, config.ppo.clip, config.ppo.gamma), (5, 0.3, demo.ppo.gamma));
        let out_of_range = Config::resolve_set("demo", None, &[setting("ppo.clip=0")]).unwrap_err().to_string();
        assert!(out_of_range.contains("ppo.clip = 0"), "{out_of_range}");
    }

    #[test]
    fn mistakes_of_a_file_are_named_with_its_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mine.toml");
        let problem = |text: &str, settings: &[Setting]| {
            std::fs::write(&path, text).unwrap();
            let error = Config::resolve_set("demo", Some(&path), settings).unwrap_err().to_string();
            error.replace(&path.display().to_string(), "mine.toml")
        };
        for (text, expected) in [
            ("[ppo]\nepochs = 100\n", "mine.toml:2: ppo.epochs = 100: must be 1 to 64"),
            (
                "seed = 1\nppo.epochs = \"two\"\n",
                "mine.toml:2: ppo.epochs: expected a whole number, found \"two\" (must be 1 to 64)",
            ),
            (
                "[[stages]]\nname = \"I\"\nreward = \"r\"\nframes = -5\n",
                "mine.toml:4: stages.frames: expected a whole number, 0 or greater, found `-5`",
            ),
            (
                "learning_rate = 1e-3\n",
                "mine.toml:1: unknown key `learning_rate` (did you mean `ppo.learning_rate` or \
                 `reward.lagrangian.learning_rate`?)",
            ),
            ("[ppo]\ncount = 1\n", "mine.toml:2: unknown key `count`"),
            ("[network]\nmlp = 64\n", "mine.toml:2: network.mlp: expected a list: write 'network.mlp=[64]'"),
            ("recording = false\n", "mine.toml:1: `recording` has keys of its own: write recording.enabled=false"),
            (
                "[learner]\nactor_deadline_s = \"1m\"\n",
                "mine.toml:2: learner.actor_deadline_s: expected a number of seconds: write learner.actor_deadline_s=60",
            ),
            (
                "[[stages]]\nname = \"I\"\n",
                "mine.toml:1: stages: missing key `reward`: a stage has name, reward and frames, as in 'stages=[{ name = \
                 \"I\", reward = \"r\", frames = 1000000 }]'; `--frames` scales all stages",
            ),
            (
                "\n[ppo]\nlerning_rate = 1e-3\n",
                "mine.toml:3: unknown key `lerning_rate` (did you mean `learning_rate`?)",
            ),
        ] {
            assert_eq!(problem(text, &[]), expected);
        }
        let text = "[ppo]\nepochs = 2\n";
        let set = problem(text, &[setting("ppo.epochs=100")]);
        assert_eq!(set, "configuration: ppo.epochs = 100: must be 1 to 64", "the file's is another");
        assert!(problem(text, &[setting("ppo.minibatches=100")]).starts_with("configuration: ppo.minibatches"));
    }

    #[test]
    fn what_to_write_instead_is_said() {
        for (text, expected) in [
            ("ppo.clip=0,2", "write ppo.clip=0.2"),
            ("ppo.clip=.2", "expected a number: write ppo.clip=0.2"),
            ("ppo.clip=1/5", "expected a number: write ppo.clip=0.2"),
            ("ppo.epochs=4.0", "expected a whole number: write ppo.epochs=4"),
            ("ppo.rollout_steps=1e3", "expected a whole number: write ppo.rollout_steps=1000"),
            ("ppo.rollout_steps=1,000", "write ppo.rollout_steps=1_000"),
            ("recording.depth_share=10%", "write recording.depth_share=0.1"),
            ("checkpoint.interval_s=5min", "expected a number of seconds: write checkpoint.interval_s=300"),
            ("learner.actor_deadline_s=1m", "expected a number of seconds: write learner.actor_deadline_s=60"),
            (
                "episode.start_distance_max_m=70cm",
                "expected a number of metres: write episode.start_distance_max_m=0.7",
            ),
            ("simulation.timestep_s=10ms", "expected a number of seconds: write simulation.timestep_s=0.01"),
            (
                "recording.segment_bytes=256MB",
                "expected a whole number of bytes: write recording.segment_bytes=256000000",
            ),
            (
                "recording.segment_bytes=1GiB",
                "expected a whole number of bytes: write recording.segment_bytes=1073741824",
            ),
            ("checkpoint.interval_s=soon", "expected a number of seconds, found \"soon\" (must be 0 or greater)"),
            ("recording.enabled=off", "expected true or false: write recording.enabled=false"),
            ("recording.enabled=True", "expected true or false: write recording.enabled=true"),
            ("network.mlp=64", "expected a list: write 'network.mlp=[64]'"),
            ("network.mlp=64,64", "write 'network.mlp=[64, 64]'"),
            ("network.mlp=(64, 64)", "write 'network.mlp=[64, 64]'"),
            ("scenes=room.toml", "expected a list: write 'scenes=[\"room.toml\"]'"),
            (
                "ppo.clip=0.1,0.2",
                "one value goes here, not several: `orchestrator suite` trains with each (docs/report.md)",
            ),
            ("seed=1,2,3", "one value goes here, not several: `orchestrator suite` trains with each (docs/report.md)"),
            ("recording=false", "`recording` has keys of its own: write recording.enabled=false"),
            ("learner=cuda", "`learner` has keys of its own: write learner.device=cuda"),
            (
                "checkpoint=300",
                "`checkpoint` has keys of its own: write checkpoint.interval_s=300 or checkpoint.keep=300",
            ),
            ("auxiliary=CPC", "`auxiliary` has keys of its own: focal_gamma, subsample, task, weight"),
            (
                "reward=r_prime",
                "a stage names its reward, as in 'stages=[{ name = \"I\", reward = \"r\", frames = 1000000 }]'",
            ),
            (
                "stages=1",
                "expected a list: a stage has name, reward and frames, as in 'stages=[{ name = \"I\", reward = \"r\", \
                 frames = 1000000 }]'; `--frames` scales all stages",
            ),
            ("network.memory=false", "unknown value `false`, expected one of `gru`, `lstm`, `none`"),
        ] {
            assert_eq!(problem(text), expected, "{text}");
        }
    }

    #[test]
    fn mistakes_are_named() {
        assert_eq!(problem("ppo.lerning_rate=1"), "unknown key `lerning_rate` (did you mean `learning_rate`?)");
        assert_eq!(problem("ppoo.epochs=1"), "unknown key `ppoo` (did you mean `ppo`?)");
        assert_eq!(problem("device=cuda"), "unknown key `device` (did you mean `learner.device`?)");
        assert_eq!(
            problem("learning_rate=1e-3"),
            "unknown key `learning_rate` (did you mean `ppo.learning_rate` or `reward.lagrangian.learning_rate`?)"
        );
        for (text, expected) in [
            ("ppo.epochs=four", "expected a whole number, found \"four\" (must be 1 to 64)"),
            ("ppo.epochs=-1", "expected a whole number, found `-1` (must be 1 to 64)"),
            ("ppo.epochs=1.5", "expected a whole number, found `1.5` (must be 1 to 64)"),
            ("ppo.clip=fast", "expected a number, found \"fast\" (must be greater than 0)"),
            ("ppo.overlap=3", "expected true or false, found `3`"),
            ("scenes=3", "expected a list: write 'scenes=[\"3\"]'"),
            (
                "stages.0.frames=10",
                "expected a list: a stage has name, reward and frames, as in 'stages=[{ name = \"I\", reward = \"r\", \
                 frames = 1000000 }]'; `--frames` scales all stages",
            ),
            ("scenes.0=a.toml", "expected a list, found a table: a list is set whole, as in 'scenes=[...]'"),
            (
                "auxiliary.task=disturbance",
                "unknown value `disturbance`, expected one of `none`, `disturb`, `inverse_dynamics`, `cpca16` (did you \
                 mean `disturb`?)",
            ),
            ("ppo.epochs=[1]", "expected a whole number, found a list (must be 1 to 64)"),
            (
                "learner.device=gpu0",
                "unknown value `gpu0`, expected one of `auto`, `cpu`, `cuda` (did you mean `cuda`?)",
            ),
            ("learner.device=gpu", "unknown value `gpu`, expected one of `auto`, `cpu`, `cuda` (did you mean `cuda`?)"),
            ("learner.device=x", "unknown value `x`, expected one of `auto`, `cpu`, `cuda`"),
        ] {
            assert_eq!(problem(text), expected, "{text}");
        }
        assert!(problem("ppo.epochs").contains("KEY=VALUE") && problem("ppo.epochs=").contains("KEY=VALUE"));
        assert!(problem("=4").contains("no key") && problem("ppo..clip=4").contains("no key"));
        for value in ["two words", "[1, 2", "1\nseed = 2", "a,b"] {
            assert!(problem(&format!("ppo.epochs={value}")).contains("neither TOML nor a single word"), "{value}");
        }
        assert!(problem("preset=paper").contains("use `--preset`"));
        assert!(problem("from.frames=3").contains("use `orchestrator up --from`"));
    }
}
