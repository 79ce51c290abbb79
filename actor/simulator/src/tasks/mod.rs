//! The tasks that are built in, each in a folder with its declaration, `task.toml`, and its environment, `mod.rs`. The
//! build script lists the folders: a new one is enough.

mod run;

pub use run::{OpenError, Run};

include!(concat!(env!("OUT_DIR"), "/tasks.rs"));

use crate::environment::Environment;
use crate::kitchen::Kitchen;
use proto::episode::EnvironmentId;
use std::sync::Arc;

/// How a task makes an environment of a run, at the start of its episode with a number.
type Open = fn(&Arc<Run>, &Arc<Kitchen>, EnvironmentId, u32) -> Result<Box<dyn Environment>, OpenError>;

/// An environment of a run's task, at the start of its episode with this number.
pub fn open(
    run: &Arc<Run>,
    kitchen: &Arc<Kitchen>,
    id: EnvironmentId,
    number: u32,
) -> Result<Box<dyn Environment>, OpenError> {
    run::check_kitchen(kitchen, id)?;
    let task = TASKS.iter().find(|(name, _)| *name == run.config.task);
    let (_, open) = task.expect("a validated configuration names a task that there is");
    open(run, kitchen, id, number)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::task::Spec;

    #[test]
    fn every_task_that_is_declared_has_an_environment() {
        let declared: Vec<&str> = Spec::built_in().iter().map(|spec| &*spec.name).collect();
        assert_eq!(TASKS.iter().map(|(name, _)| *name).collect::<Vec<_>>(), declared);
    }
}
