//! Any bytes as what an environment reports: what passes the check can be trained on.
#![no_main]

use libfuzzer_sys::fuzz_target;
use proto::plausible;
use proto::reward::RewardKind;
use proto::step::{Current, Transition};

fuzz_target!(|bytes: (&[u8; 88], &[u8; 112])| {
    let transition: Transition = bytemuck::pod_read_unaligned(bytes.0);
    let current: Current = bytemuck::pod_read_unaligned(bytes.1);
    if plausible::check(Some(&transition), &current).is_ok() {
        for kind in [RewardKind::Task, RewardKind::DisturbanceFree, RewardKind::Lagrangian] {
            assert!(transition.reward.compose(kind, 15.0).abs() < 2e6);
        }
        let numbers = current.wrist_to_object_m.iter().chain(&current.object_to_goal_m);
        assert!(numbers.chain(&current.goal_position_m).all(|number| number.abs() <= 1e5));
    }
});
