//! What fuzzing has kept of configurations and payloads.

#[path = "../../fuzz/src/configuration.rs"]
mod configuration;
#[path = "../../fuzz/src/kept.rs"]
mod kept;
#[path = "../../fuzz/src/payload.rs"]
mod payload;

#[test]
fn kept_configurations_are_read_or_refused() {
    kept::each("configuration", configuration::take);
}

#[test]
fn kept_payloads_are_trained_on_or_refused() {
    kept::each("payload", payload::take);
}
