//! Samples that no correct actor sends.

use super::environments::Mismatch;
use wire::message::ObservationHeader;

/// A sample that no correct actor sends.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ProtocolError {
    /// The header makes no sense.
    #[error("an observation sample has a header that makes no sense: {0:?}")]
    Header(ObservationHeader),
    /// The payload is not one half.
    #[error("actor {actor} sent {found} observations for half {half}, which has {expected} environments")]
    Length {
        actor: u32,
        half: u32,
        /// Observations in the sample.
        found: usize,
        /// Environments of the half.
        expected: usize,
    },
    /// It answers an action that was never sent.
    #[error("actor {actor} is at exchange {found} of half {half}, but the learner has only sent actions up to {sent}")]
    Ahead {
        actor: u32,
        half: u32,
        /// Its step.
        found: u64,
        /// Exchange the learner is at.
        sent: u64,
    },
    /// An environment is not where it must be.
    #[error(transparent)]
    Mismatch(#[from] Mismatch),
}

impl ProtocolError {
    /// Whether it is nothing but a number that is not finite.
    pub fn is_non_finite(&self) -> bool {
        matches!(self, Self::Mismatch(Mismatch { non_finite: true, .. }))
    }
}
