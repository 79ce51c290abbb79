//! Random actions in a few kitchens, watched at every sub-step: `actor soak` in small.

use actor::soak::{DEPTH_LIMIT_M, Report, SPEED_LIMIT_M_PER_S, soak};
use proto::config::Config;
use proto::kitchen::KitchenId;
use simulator::kitchen::Kitchen;
use std::sync::Arc;

#[test]
fn nothing_tunnels_and_nothing_explodes() {
    let mut config = Config::default();
    // Near enough to the target for the arm to meet something.
    config.episode.start_distance_max_m = 0.8;
    let mut disturbing = 0;
    for number in [8, 12, 16, 20, 26] {
        let kitchen = Kitchen::build(KitchenId::new(number).unwrap(), &config.simulation).unwrap();
        let report = soak(&Arc::new(kitchen), 2000, 3, &config).unwrap();
        assert_eq!(report.failures(), Vec::<String>::new(), "kitchen {number}: {report:?}");
        assert_eq!((report.steps, report.episodes), (2000, 11), "the last of ten full episodes has just ended");
        disturbing += report.disturbing_steps;
    }
    assert!(disturbing > 50, "10,000 random actions moved something {disturbing} times: too few to tell");
}

#[test]
fn a_report_says_what_is_wrong() {
    let mut report = Report::default();
    assert!(report.failures().is_empty());
    report.extremes.fastest_m_per_s = SPEED_LIMIT_M_PER_S;
    report.extremes.deepest_in_fixed_m = DEPTH_LIMIT_M;
    report.extremes.left_room = 1;
    report.extremes.not_finite = 2;
    assert_eq!(report.failures().len(), 4);
}
