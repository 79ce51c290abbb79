//! Any text as a configuration: one that can be used, or an error.

use proto::config::Config;
use proto::stage::{position_at, total_frames};

/// Whether it can be used, by itself or over a preset.
pub fn take(bytes: &[u8]) -> bool {
    let Ok(text) = std::str::from_utf8(bytes) else { return false };
    let found = [Config::from_toml(text, "a"), Config::resolve_with("demo", Some((text, "a")))];
    for found in &found {
        match found {
            Ok(config) => {
                assert_eq!(
                    Config::from_toml(&config.to_toml(), "b").as_ref().expect("what was printed is read"),
                    config
                );
                assert!(total_frames(&config.stages) > 0 && position_at(&config.stages, u64::MAX).is_none());
            }
            Err(error) => assert!(!error.to_string().is_empty()),
        }
    }
    found.iter().any(Result::is_ok)
}
