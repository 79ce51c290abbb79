//! Where a run's processes run on the machine. Nothing of it changes what a run computes.

use serde::{Deserialize, Serialize};

/// Settings of the machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MachineConfig {
    /// Hold each learner and its actors to the cores near the learner's GPU, divided where several GPUs have the same;
    /// without GPUs all cores are divided among the learners.
    pub pin: bool,
}
