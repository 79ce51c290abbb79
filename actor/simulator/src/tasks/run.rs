use crate::kitchen::Kitchen;
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::evaluation::Plan;
use proto::kitchen::KitchenId;
use std::sync::Arc;

#[derive(Debug, Clone)]
pub struct Run {
    pub config: Config,
    /// Which episodes an evaluation deals to them.
    pub(super) plan: Option<Arc<Plan>>,
}

impl Run {
    /// One of this configuration, which was validated.
    pub fn of(config: &Config) -> Arc<Self> {
        Arc::new(Self { config: config.clone(), plan: config.evaluation_plan().map(Arc::new) })
    }

    /// In an evaluation: the number in its table of the episode that an environment plays as its episode `number`. None
    /// after its last one.
    pub fn dealt(&self, id: EnvironmentId, number: u32) -> Option<u32> {
        self.plan.as_ref()?.dealt(id, number)
    }

    /// The number of that episode in state hashes: in an evaluation equal episodes have equal ones, whichever environment
    /// plays them.
    pub(super) fn hashed_number(&self, id: EnvironmentId, number: u32) -> u32 {
        let by_kitchen = self.config.evaluation.as_ref().is_some_and(|asked| asked.hashes_by_kitchen);
        if by_kitchen { self.dealt(id, number).unwrap_or(number) } else { number }
    }
}

#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    #[error("environment of kitchen {wanted} was given kitchen {given}")]
    WrongKitchen { wanted: KitchenId, given: KitchenId },
    #[error("{0}")]
    NoEpisodes(String),
}

pub(super) fn check_kitchen(kitchen: &Kitchen, id: EnvironmentId) -> Result<(), OpenError> {
    let given = kitchen.id();
    if given == id.kitchen { Ok(()) } else { Err(OpenError::WrongKitchen { wanted: id.kitchen, given }) }
}
