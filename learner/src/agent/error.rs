use crate::ffi::graph::GraphError;
use crate::ffi::stream::StreamError;
use crate::network::{PrecisionError, Unfit};
use crate::peers::PeerError;
use proto::config::{CarriedGoal, NetworkConfig};

#[derive(Debug, thiserror::Error)]
pub enum AgentError {
    #[error("{what} is not finite")]
    NonFinite { what: String },
    #[error("column {column}: the policy has no action {action}, but the batch has it as taken")]
    UnknownAction { column: usize, action: u8 },
    #[error(transparent)]
    Precision(#[from] PrecisionError),
    #[error("acting: {0}")]
    Acting(#[from] GraphError),
    #[error("ppo.overlap needs streams of the GPU: {0}. Without it the run goes on: ppo.overlap = false")]
    Stream(#[from] StreamError),
    #[error("cannot start a thread for updates (ppo.overlap): {0}")]
    Thread(std::io::Error),
    #[error(transparent)]
    Peers(#[from] PeerError),
    #[error("the saved state does not fit: {0}")]
    State(#[from] Unfit),
    #[error(transparent)]
    Sign(#[from] OtherSign),
}

/// Weights that were trained with the other sign of the goal vector.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "the weights were trained with network.carried_goal = \"{trained}\", the configuration says \"{configured}\": while \
     the target is held they would see their goal in the opposite direction. Set network.carried_goal = \"{trained}\""
)]
pub struct OtherSign {
    pub trained: CarriedGoal,
    pub configured: CarriedGoal,
}

impl OtherSign {
    /// Refuses weights that were trained with another sign than this network's, where it sees one.
    pub fn refuse(trained: CarriedGoal, network: &NetworkConfig) -> Result<(), Self> {
        match network.sign_seen() {
            Some(configured) if configured != trained => Err(Self { trained, configured }),
            _ => Ok(()),
        }
    }
}
