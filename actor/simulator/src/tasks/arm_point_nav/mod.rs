//! `ArmPointNav`: fetch the target, bring it to its goal, and leave the rest as it was.

mod environment;
pub mod episode;
pub mod episodes;
mod step;

pub use environment::Environment;
pub use step::{Current, RewardParts, Transition, check, write};

use crate::kitchen::Kitchen;
use crate::tasks::run::{OpenError, Run};
use proto::episode::EnvironmentId;
use std::sync::Arc;

/// A success with less total displacement than this is one without disturbance, metres: as `task.toml` declares it.
pub const UNDISTURBED_THRESHOLD_M: f32 = 0.01;

/// An environment of a run, at the start of its episode with this number.
pub(super) fn open(
    run: &Arc<Run>,
    kitchen: &Arc<Kitchen>,
    id: EnvironmentId,
    number: u32,
) -> Result<Box<dyn crate::environment::Environment>, OpenError> {
    step::assert_declared();
    Ok(Box::new(Environment::open(run, Arc::clone(kitchen), id, number)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::task::Spec;

    #[test]
    fn the_metric_has_the_threshold_of_the_code() {
        let spec = Spec::built_in().iter().find(|spec| spec.name == "arm_point_nav").unwrap();
        let named = |name: &str| spec.metrics.iter().position(|metric| metric.name == name).unwrap();
        let measure = &spec.measures()[named("success_without_disturbance")];
        let below = UNDISTURBED_THRESHOLD_M.next_down();
        for (displaced_m, is_so) in [(below, 1.0), (UNDISTURBED_THRESHOLD_M, 0.0)] {
            let number =
                |index: usize| if spec.channels[index].name == "disturbance_m" { f64::from(displaced_m) } else { 1.0 };
            assert_eq!(measure.after(number, 0.0), is_so);
        }
    }
}
