use super::environments::Mismatch;
use wire::message::ObservationHeader;

#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ProtocolError {
    #[error("an observation sample has a header that makes no sense: {0:?}")]
    Header(ObservationHeader),
    #[error("actor {actor} sent {found} observations for half {half}, which has {expected} environments")]
    Length { actor: u32, half: u32, found: usize, expected: usize },
    #[error("actor {actor} is at exchange {found} of half {half}, but the learner has only sent actions up to {sent}")]
    Ahead { actor: u32, half: u32, found: u64, sent: u64 },
    #[error(transparent)]
    Mismatch(#[from] Mismatch),
}

impl ProtocolError {
    pub fn is_non_finite(&self) -> bool {
        matches!(self, Self::Mismatch(Mismatch { non_finite: true, .. }))
    }
}
