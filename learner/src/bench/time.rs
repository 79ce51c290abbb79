//! What measurements have in common.

use crate::ffi::graph::wait_for_device;
use tch::Device;

/// Waits until a device has done all that it was given.
pub fn synchronise(device: Device) {
    if let Device::Cuda(index) = device {
        wait_for_device(index);
    }
}

/// The value below which this share of sorted values lies.
pub fn percentile(sorted: &[f64], share: f64) -> f64 {
    sorted[((sorted.len() - 1) as f64 * share).round() as usize]
}
