//! Any bytes as what an environment reports of a step: what passes the check can be trained on.

use proto::config::Config;
use proto::record::{RecordHeader, flag};
use proto::task::Check;

/// Whether it is trained on.
pub fn take(bytes: &[u8]) -> bool {
    let config = Config::default();
    let (spec, layout) = (config.spec(), config.spec().layout());
    let Some(record) = bytes.get(..layout.small_bytes) else { return false };
    let header: RecordHeader = bytemuck::pod_read_unaligned(&record[..size_of::<RecordHeader>()]);
    if header.check().is_err() {
        return false;
    }
    if let Err(problem) = Check::of(spec).record(record, header.has(flag::ACTED)) {
        assert!(!problem.to_string().is_empty());
        return false;
    }
    if header.has(flag::ACTED) {
        for reward in &spec.rewards {
            assert!(config.reward(&reward.name).of(|index| layout.part(record, index), 15.0).abs() < 2e6);
        }
    }
    for (channel, field) in spec.channels.iter().zip(&layout.fields) {
        assert!(channel.is_bulk() || channel.is_of_action() || field.numbers(record).all(|number| number.abs() <= 1e5));
    }
    true
}
