//! How busy a GPU is while something is measured.

use crate::ffi::gpu::{Reading, Watch, pci_address};
use serde::Serialize;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tch::Device;

/// Between two looks. The driver itself averages over a sixth of a second to a second.
const LOOK: Duration = Duration::from_millis(50);

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Use {
    /// Mean share of the time in which a kernel ran, 0..1.
    pub busy: f64,
    /// The most memory that all its processes took, bytes.
    #[serde(rename = "memory_bytes")]
    pub memory: u64,
}

/// Watches a device; a CPU, or a GPU without its management library, is not watched.
#[derive(Debug)]
pub struct Monitor(Option<Arc<Watch>>);

impl Monitor {
    pub fn of(device: Device) -> Self {
        let Device::Cuda(index) = device else { return Self(None) };
        let Some(pci) = pci_address(index) else { return Self(None) };
        let watch = Watch::open(&pci).inspect_err(|error| tracing::warn!("the GPU is not watched: {error}"));
        Self(watch.ok().map(Arc::new))
    }

    pub fn during<T>(&self, work: impl FnOnce() -> T) -> (T, Option<Use>) {
        let Some(watch) = self.0.clone() else { return (work(), None) };
        let done = Arc::new(AtomicBool::new(false));
        let over = done.clone();
        let readings = std::thread::spawn(move || {
            let mut readings = vec![];
            while !over.load(Ordering::Relaxed) {
                std::thread::sleep(LOOK);
                readings.extend(watch.read().ok());
            }
            readings
        });
        let result = work();
        done.store(true, Ordering::Relaxed);
        (result, mean(&readings.join().unwrap_or_default()))
    }
}

fn mean(readings: &[Reading]) -> Option<Use> {
    let memory = readings.iter().map(|reading| reading.memory).max()?;
    Some(Use { busy: readings.iter().map(|reading| reading.busy).sum::<f64>() / readings.len() as f64, memory })
}
