//! Any text as a configuration: one that can be used, or an error.

use proto::config::Config;
use proto::stage::{position_at, total_frames};

pub fn take(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    for found in [Config::from_toml(text, "a"), Config::resolve_with("demo", Some((text, "a")))] {
        match found {
            Ok(config) => {
                assert_eq!(Config::from_toml(&config.to_toml(), "b").expect("what was printed is read"), config);
                assert!(total_frames(&config.stages) > 0 && position_at(&config.stages, u64::MAX).is_none());
            }
            Err(error) => assert!(!error.to_string().is_empty()),
        }
    }
}
