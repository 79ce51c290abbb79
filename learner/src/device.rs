//! Where libtorch computes.

use proto::config::DeviceChoice;
use tch::Device;

/// Loads libtorch's CUDA half if this machine has it. Must be the first line of `main`.
pub fn load_cuda() {
    unimplemented!()
}

/// A device that was asked for but is not there.
#[derive(Debug, thiserror::Error)]
pub enum DeviceError {
    /// CUDA was asked for.
    #[error("learner.device is \"cuda\" but libtorch finds no CUDA device")]
    NoCuda,
}

/// Picks the device and fixes libtorch's thread counts. Call once, before any tensor is made.
pub fn choose(_choice: DeviceChoice, _threads: u32) -> Result<Device, DeviceError> {
    unimplemented!()
}

/// Words for logs and the `Ready` event, e.g. `cpu, 2 threads` or `cuda:0`.
pub fn describe(_device: Device) -> String {
    unimplemented!()
}
