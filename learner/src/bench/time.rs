use crate::ffi::graph::wait_for_device;
use tch::Device;

pub fn synchronise(device: Device) {
    if let Device::Cuda(index) = device {
        wait_for_device(index);
    }
}

pub fn percentile(sorted: &[f64], share: f64) -> f64 {
    sorted[((sorted.len() - 1) as f64 * share).round() as usize]
}
