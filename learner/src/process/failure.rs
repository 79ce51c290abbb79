//! Why a learner ends: errors that have an exit status of their own.

use super::writing::Unrecorded;
use crate::agent::AgentError;
use crate::checkpoint::{CheckpointError, encode_tensors};
use crate::collector::ProtocolError;
use crate::peers::PeerError;
use anyhow::Context;
use proto::run_folder::write_atomically;
use std::collections::BTreeMap;
use std::path::Path;
use tch::Tensor;

/// A number is not finite; `dump` is the file with the rollout that it came from.
#[derive(Debug, thiserror::Error)]
#[error("{what}; what rollout {rollout} was made of is in {dump}")]
pub struct NonFinite {
    pub(super) rollout: u64,
    pub(super) what: String,
    pub(super) dump: String,
}

impl NonFinite {
    pub(super) fn dumped(rollout: u64, error: &anyhow::Error, path: &Path, tensors: &BTreeMap<String, Tensor>) -> Self {
        let written = encode_tensors(tensors)
            .map_err(anyhow::Error::from)
            .and_then(|bytes| write_atomically(path, &bytes).context("cannot write"));
        let dump = match written {
            Ok(()) => path.display().to_string(),
            Err(cause) => format!("no file: {}: {cause:#}", path.display()),
        };
        Self { rollout, what: format!("{error:#}"), dump }
    }
}

#[derive(Debug, thiserror::Error)]
pub enum Unsaved {
    #[error(transparent)]
    Here(#[from] CheckpointError),
    #[error("the first learner could not write the checkpoint")]
    Elsewhere,
    #[error(
        "no checkpoint is written: another host could not write its recordings to its disk, and says why in its log"
    )]
    OtherHost,
}

/// Whether an error is that this learner could not write a checkpoint, or that nothing is recorded any more: the process
/// then ends with [`proto::exit::EXIT_UNSAVED`].
pub fn is_unsaved(error: &anyhow::Error) -> bool {
    matches!(error.downcast_ref(), Some(Unsaved::Here(_)))
        || matches!(error.downcast_ref(), Some(Unrecorded::Standstill(_)))
}

/// Whether an error is about a number that is not finite: the process then ends with
/// [`proto::exit::EXIT_NON_FINITE`].
pub fn is_non_finite(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| {
        cause.is::<NonFinite>()
            || matches!(cause.downcast_ref(), Some(AgentError::NonFinite { .. }))
            || cause.downcast_ref().is_some_and(ProtocolError::is_non_finite)
    })
}

/// Whether an error is that another learner is gone or cannot go on: the process then ends with
/// [`proto::exit::EXIT_LOST_PEERS`].
pub fn is_of_peers(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| {
        let peers = cause.downcast_ref().or(match cause.downcast_ref() {
            Some(AgentError::Peers(error)) => Some(error),
            _ => None,
        });
        matches!(peers, Some(PeerError::Lost { .. } | PeerError::Elsewhere))
            || matches!(cause.downcast_ref(), Some(Unsaved::Elsewhere | Unsaved::OtherHost))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::collector::Mismatch;
    use wire::Standstill;

    #[test]
    fn a_number_that_is_not_finite_is_found_under_whatever_was_said_on_the_way() {
        let seen = |error: anyhow::Error| is_non_finite(&error.context("in the middle").context("of something"));
        let mismatch = |non_finite| {
            ProtocolError::from(Mismatch {
                actor: 0,
                kitchen: None,
                environment: 0,
                problem: String::new(),
                non_finite,
            })
        };
        assert!(seen(AgentError::NonFinite { what: "loss".into() }.into()));
        assert!(seen(mismatch(true).into()));
        assert!(!seen(mismatch(false).into()));
        assert!(!seen(AgentError::UnknownAction { column: 0, action: 99 }.into()));
        assert!(!seen(anyhow::anyhow!("a weight is not finite")));
    }

    /// A rollout that is late is another thing: what is trained is saved, and the learner started again.
    #[test]
    fn a_recording_that_stands_still_ends_the_run_without_a_restart() {
        let seen = |error: Unrecorded| is_unsaved(&anyhow::Error::from(error).context("in the middle"));
        assert!(seen(Unrecorded::Standstill(Standstill::DEADLINE)) && !seen(Unrecorded::Late { rollout: 3 }));
    }
}
