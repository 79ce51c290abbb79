//! Why a rollout is abandoned, and what all learners make of the reasons that some have. Pure.

use super::stop::Stop;
use crate::peers::PeerError;

/// Why a rollout is abandoned. The work up to its beginning is good.
#[derive(Debug)]
pub enum CutShort {
    Stop(Stop),
    Fault(anyhow::Error),
}

/// A learner's reason to abandon a rollout as numbers that can be summed: a stop announced, no orchestrator, a fault.
pub fn reasons(own: Option<&CutShort>) -> [f64; 3] {
    let flag = |condition: bool| f64::from(u8::from(condition));
    [
        flag(matches!(own, Some(CutShort::Stop(Stop::Announced)))),
        flag(matches!(own, Some(CutShort::Stop(Stop::OrchestratorGone)))),
        flag(matches!(own, Some(CutShort::Fault(_)))),
    ]
}

/// Why all abandon a rollout, by the sums of their [`reasons`].
pub fn joint_end(own: Option<CutShort>, [announced, gone, faults]: [f64; 3]) -> Option<CutShort> {
    match own {
        Some(CutShort::Fault(error)) => Some(CutShort::Fault(error)),
        _ if faults > 0.0 => Some(CutShort::Fault(PeerError::Elsewhere.into())),
        _ if gone > 0.0 => Some(CutShort::Stop(Stop::OrchestratorGone)),
        _ if announced > 0.0 => Some(CutShort::Stop(Stop::Announced)),
        _ => None,
    }
}
