use crate::whereabouts::Whereabouts;
use std::error::Error;

#[derive(Debug, thiserror::Error)]
pub enum EngineError {
    #[error("the run has actors 0 to {last}: there is no actor {actor}")]
    NoSuchActor { actor: u32, last: u32 },
    #[error(transparent)]
    Wire(#[from] wire::WireError),
    #[error("cannot {work}")]
    Port {
        work: &'static str,
        #[source]
        cause: Box<dyn Error + Send + Sync>,
    },
    #[error(transparent)]
    Simulator(Box<dyn Error + Send + Sync>),
    #[error("an actor has environments")]
    NoEnvironments,
    #[error("the learner sent action {action} to {place}: there is none")]
    NoSuchAction { action: String, place: Whereabouts },
    #[error(transparent)]
    BadRestore(#[from] wire::message::BadRestore),
    #[error("a restore names action {action} at step {step} of {place}: there is none")]
    NoSuchActionBefore { action: String, step: usize, place: Whereabouts },
    #[error(
        "a restore has {actions} actions for {place}, which ends after {ended}: was the run recorded with another version \
         of the simulator?"
    )]
    EndsEarlier { actions: usize, place: Whereabouts, ended: usize },
    #[error(
        "{place}, step {step}: the same seed and actions led to another state before this process was started. {advice}"
    )]
    Differs { place: String, step: u32, advice: &'static str },
    #[error(
        "{place} was cut off, and its environment cannot be restored (metadata[\"restore\"] is \"none\"): evaluate again"
    )]
    CutEvaluation { place: Whereabouts },
    #[error("{place} cannot be put back to where it began, of which there is no snapshot: a new process begins there")]
    NoSnapshot { place: Whereabouts },
}

impl EngineError {
    pub(crate) fn port<E: Error + Send + Sync + 'static>(work: &'static str) -> impl Fn(E) -> Self {
        move |cause| Self::Port { work, cause: Box::new(cause) }
    }
}
