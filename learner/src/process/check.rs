//! `learner check`: proof that libtorch loads and computes, before anything is started.

use super::machine::{TORCH_VERSION, machine, torch_library, torch_version};
use crate::ffi::gpu::pci_address;
use anyhow::{Result, bail};
use proto::config::LearnerConfig;
use proto::device::Torch;
use std::io::Write;
use tch::{Cuda, Device, Kind, Tensor};

/// Looks at the libtorch that is loaded, lets it compute something, and prints what it is.
pub fn check(mut output: impl Write) -> Result<()> {
    let library = torch_library().map_or_else(|| "unknown".to_owned(), |path| path.display().to_string());
    match torch_version() {
        Some(version) if version == TORCH_VERSION => {}
        Some(version) => {
            bail!("libtorch {version} is loaded from {library}; this program needs {TORCH_VERSION}")
        }
        None => tracing::warn!("the version of {library} is unknown; this program needs {TORCH_VERSION}"),
    }
    let sum =
        Tensor::f_ones([4, 4], (Kind::Float, Device::Cpu))?.f_mm(&Tensor::f_eye(4, (Kind::Float, Device::Cpu))?)?;
    let sum = f64::try_from(sum.f_sum(Kind::Double)?)?;
    if sum != 16.0 {
        bail!("libtorch from {library} computes 16 as {sum}");
    }
    let gpus = if Cuda::is_available() { Cuda::device_count() } else { 0 };
    let mut devices: Vec<String> = (0..gpus).map(|index| format!("cuda:{index}")).collect();
    devices.push("cpu".to_owned());
    let machine = machine(Device::Cpu, LearnerConfig::default());
    let pci = (0..gpus).map(|index| pci_address(index as usize)).collect::<Option<Vec<_>>>().unwrap_or_default();
    let torch = Torch { version: machine.torch, library, devices, pci, arithmetic: machine.arithmetic };
    writeln!(output, "{}", serde_json::to_string(&torch)?)?;
    Ok(())
}
