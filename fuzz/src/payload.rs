//! Any bytes as what an environment reports of a step: what passes the check can be trained on.

use proto::config::Config;
use proto::plausible;
use proto::record::RecordHeader;
use proto::step::{Current, Transition};

/// Whether it is trained on.
pub fn take(bytes: &[u8]) -> bool {
    let Some((first, rest)) = bytes.split_at_checked(size_of::<RecordHeader>()) else { return false };
    let Some((second, rest)) = rest.split_at_checked(size_of::<Transition>()) else { return false };
    let Some(third) = rest.get(..size_of::<Current>()) else { return false };
    let header: RecordHeader = bytemuck::pod_read_unaligned(first);
    let transition: Transition = bytemuck::pod_read_unaligned(second);
    let current: Current = bytemuck::pod_read_unaligned(third);
    if header.check().is_err() {
        return false;
    }
    if let Err(problem) = plausible::check(Some(&transition), &current) {
        assert!(!problem.to_string().is_empty());
        return false;
    }
    let config = Config::default();
    for reward in &config.spec().rewards {
        assert!(config.reward(&reward.name).of(|index| transition.reward.part(index), 15.0).abs() < 2e6);
    }
    let numbers = current.wrist_to_object_m.iter().chain(&current.object_to_goal_m);
    assert!(numbers.chain(&current.goal_position_m).all(|number| number.abs() <= 1e5));
    true
}
