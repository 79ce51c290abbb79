//! What has changed in a run's configuration since a checkpoint was written. Pure.

use proto::checkpoint::Manifest;
use proto::config::Config;
use proto::digest::sha256;

/// What has changed, in words; none when nothing has. `file`: the text of config.toml that `config` was read from.
///
/// Keys that a newer version has added are no change: they have the values under which the run began.
pub fn since(manifest: &Manifest, config: &Config, file: &str) -> Option<String> {
    // A file that an older version wrote lacks keys that `config` has; it is as it was if its text is.
    if [config.to_toml().as_str(), file].iter().any(|text| sha256(text.as_bytes()) == manifest.config_sha256) {
        return None;
    }
    if manifest.config.is_empty() {
        return Some("in what is not known, because an older version wrote that checkpoint".to_owned());
    }
    match Config::from_toml(&manifest.config, "its configuration") {
        Ok(mut older) => {
            // Another budget is what `orchestrator resume --frames` has announced.
            older.stages.iter_mut().zip(&config.stages).for_each(|(older, stage)| older.frames = stage.frames);
            Some(config.changes_since(&older)).filter(|found| !found.is_empty()).map(|found| found.join(", "))
        }
        Err(error) => Some(format!("this version cannot read the older one ({error})")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of a checkpoint written under this configuration. `kept`: by a version that keeps its text.
    fn manifest(config: &str, kept: bool) -> Manifest {
        let config_sha256 = sha256(config.as_bytes());
        let config = if kept { config.to_owned() } else { String::new() };
        Manifest { config_sha256, config, ..Manifest::default() }
    }

    #[test]
    fn changed_keys_are_named_and_keys_of_a_newer_version_are_no_change() {
        let config = Config::resolve("demo", None).unwrap();
        let text = config.to_toml();
        // As a version without this key would have written it.
        let line = text.lines().find(|line| line.starts_with("learning_rate_frames")).unwrap();
        let old = text.replace(&format!("{line}\n"), "");
        assert_ne!(old, text);
        let read = Config::from_toml(&old, "config.toml").unwrap();
        for kept in [false, true] {
            assert_eq!(since(&manifest(&text, kept), &config, &text), None);
            assert_eq!(since(&manifest(&old, kept), &read, &old), None, "only the version is new");
        }
        let mut changed = read.clone();
        changed.stages[0].frames += 1;
        assert_eq!(since(&manifest(&old, true), &changed, &changed.to_toml()), None, "that was asked for");
        changed.ppo.epochs += 3;
        let file = changed.to_toml();
        let said = since(&manifest(&old, true), &changed, &file).unwrap();
        assert_eq!(said, format!("ppo.epochs = {} instead of {}", changed.ppo.epochs, read.ppo.epochs));
        assert!(since(&manifest(&old, false), &changed, &file).unwrap().contains("not known"));
        // Written whole by the newer version, with the values of the old run.
        assert_eq!(since(&manifest(&old, true), &read, &read.to_toml()), None);
        assert!(since(&manifest("x = 1", true), &config, &text).unwrap().contains("unknown key `x`"));
    }
}
