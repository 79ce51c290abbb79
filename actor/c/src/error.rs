use engine::guest::{GuestError, ReplayError};

#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    #[error("{0}")]
    Refused(String),
    #[error(transparent)]
    Part(#[from] GuestError),
    #[error(transparent)]
    Replay(#[from] ReplayError),
    #[error(transparent)]
    Spec(#[from] proto::task::SpecError),
    #[error("cannot answer: {0}")]
    Answer(#[from] std::io::Error),
    #[error("it does not describe itself: {0}")]
    Description(#[from] serde_json::Error),
}

impl ServeError {
    pub fn status(&self) -> i32 {
        if matches!(self, Self::Refused(_)) { 2 } else { 1 }
    }
}
