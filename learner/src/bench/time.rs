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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_values_that_were_measured() {
        let sorted: Vec<f64> = (0..=100).map(f64::from).collect();
        assert_eq!([0.0, 0.5, 0.99, 1.0].map(|share| percentile(&sorted, share)), [0.0, 50.0, 99.0, 100.0]);
        assert_eq!(percentile(&[3.0], 0.99), 3.0);
    }
}
