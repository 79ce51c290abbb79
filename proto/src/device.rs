//! What a learner computes on: the libtorch that it finds, and which of a machine's GPUs it sees.

use serde::{Deserialize, Serialize};

/// What `learner check` prints, one line of JSON: the libtorch that is loaded and what it can do here.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Torch {
    /// Version of libtorch.
    #[serde(rename = "torch")]
    pub version: String,
    pub library: String,
    /// Devices it can compute on: `cuda:0`, ..., `cpu`.
    pub devices: Vec<String>,
    /// Addresses of its GPUs on the PCI bus, as sysfs names them, in the order of `devices`; empty if one is unknown.
    #[serde(default)]
    pub pci: Vec<String>,
    /// The CPU's arithmetic: `reproducible`, or the instruction set of libtorch's kernels.
    pub arithmetic: String,
}

impl Torch {
    pub fn has_cuda(&self) -> bool {
        self.cuda_devices() > 0
    }

    pub fn cuda_devices(&self) -> usize {
        self.devices.iter().filter(|device| device.starts_with("cuda")).count()
    }
}

/// The variable that lists the CUDA devices which a process sees: numbers or UUIDs, separated by commas. The
/// orchestrator sets it for its learners.
pub const VISIBLE_DEVICES: &str = "CUDA_VISIBLE_DEVICES";

/// The machine's name of device `index` among the `visible` ones; without a list all are visible. Empty if there are
/// not so many, so that no other device is used by mistake.
pub fn device_name(index: usize, visible: Option<&str>) -> String {
    match visible {
        None => index.to_string(),
        Some(visible) => visible.split(',').nth(index).unwrap_or_default().trim().to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn devices_are_those_that_are_given() {
        let names = |visible| [0, 1].map(|index| device_name(index, visible));
        assert_eq!(names(None), ["0", "1"]);
        assert_eq!(names(Some("3, 5,6")), ["3", "5"]);
        assert_eq!(names(Some("GPU-3cdeb329")), ["GPU-3cdeb329", ""]);
    }
}
