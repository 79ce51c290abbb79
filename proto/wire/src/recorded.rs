//! Both ends of the bell `recorded/RANK`, which announces new receipts to a learner.

use crate::error::WireError;
use crate::services::{Bell, Wakeup, Wire, open, port, recorded_name, required_attributes, service};

impl Wire {
    /// Rings when the recorder has taken something that this learner waits for.
    pub fn recorded_wakeup(&self, rank: u32) -> Result<Wakeup, WireError> {
        let name = recorded_name(rank);
        let service = open!(self.recorded(rank), &name);
        service.listener_builder().create().map_err(|cause| port(&name, &cause))
    }

    /// The recorder's bell for one learner.
    pub fn recorded_bell(&self, rank: u32) -> Result<Bell, WireError> {
        let name = recorded_name(rank);
        let service = open!(self.recorded(rank), &name);
        service.notifier_builder().create().map_err(|cause| port(&name, &cause))
    }
}
