//! Any text as a configuration: one that can be used, or an error.
#![no_main]

use libfuzzer_sys::fuzz_target;
use proto::config::Config;
use proto::stage::{position_at, total_frames};

fuzz_target!(|text: &str| {
    for found in [Config::from_toml(text, "a"), Config::resolve_with("demo", Some((text, "a")))] {
        match found {
            Ok(config) => {
                assert_eq!(Config::from_toml(&config.to_toml(), "b").unwrap(), config);
                assert!(total_frames(&config.stages) > 0 && position_at(&config.stages, u64::MAX).is_none());
            }
            Err(error) => assert!(!error.to_string().is_empty()),
        }
    }
});
