//! `ArmPointNav`: fetch the target, bring it to its goal, and leave the rest as it was.

mod environment;
pub mod episode;
pub mod episodes;
pub mod oracle;
mod step;

pub use environment::Environment;
pub use step::{Current, Transition, check, record};

use crate::kitchen::Kitchen;
use crate::tasks::run::{OpenError, Run};
use proto::episode::EnvironmentId;
use std::sync::Arc;

/// An environment of a run, at the start of its episode with this number.
pub(super) fn open(
    run: &Arc<Run>,
    kitchen: &Arc<Kitchen>,
    id: EnvironmentId,
    number: u32,
) -> Result<Box<dyn crate::environment::Environment>, OpenError> {
    Ok(Box::new(Environment::open(run, Arc::clone(kitchen), id, number)?))
}

#[cfg(test)]
mod tests {
    use super::episode::GOAL_TOLERANCE_M;
    use crate::robot::action::Action;
    use proto::task::Spec;

    #[test]
    fn the_task_declares_the_actions_that_the_robot_has() {
        let names = Action::ALL.map(|action| format!("{action:?}"));
        assert_eq!(Spec::named("arm_point_nav").unwrap().actions.names(), names);
    }

    #[test]
    fn pictures_mark_the_goal_as_large_as_it_is() {
        let (goal, _) = Spec::named("arm_point_nav").unwrap().channel("goal_position_m").unwrap();
        assert_eq!(goal.tolerance, Some(GOAL_TOLERANCE_M));
    }
}
