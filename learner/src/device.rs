use crate::ffi::{arithmetic, determinism, library, refusal, warnings};
use proto::config::{CpuArithmetic, DeviceChoice, LearnerConfig};
use proto::device::{VISIBLE_DEVICES, device_name};
use tch::kind::Element;
use tch::{Cuda, Device, Tensor};

/// Loads libtorch's CUDA half if this machine has it, so that one binary serves CPU and GPU machines.
///
/// Must be the first line of `main`: libtorch looks for CUDA once, at its first query or computation. If it finds none
/// then, CUDA stays unavailable. Without the library, or without a driver, nothing happens.
pub fn load_cuda() {
    // Without it there is no GPU to compute on: no error.
    let _ = library::open(&[c"libtorch_cuda.so"]);
}

/// For tests that need a CUDA device: until the guard is dropped no other test of this process uses it. Where one records a
/// graph, libtorch's generator of random numbers serves nobody else.
#[cfg(test)]
pub(crate) fn cuda_alone() -> std::sync::MutexGuard<'static, ()> {
    static DEVICE: std::sync::Mutex<()> = std::sync::Mutex::new(());
    load_cuda();
    determinism::use_deterministic();
    // Nothing lies behind the lock that a test which failed could leave half done.
    DEVICE.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}

/// Lets the heap, in which tensors of the CPU lie, keep freed memory for the next ones. By default glibc gives large
/// blocks back to the kernel, which fills their pages with zeros again: on two cores a tenth of a training's time. Call
/// it before other threads start.
pub fn keep_freed_memory() {
    #[cfg(target_env = "gnu")]
    // SAFETY: it sets numbers of the allocator. One that is refused leaves the default, which is slower.
    unsafe {
        // The largest size of a block of the heap that glibc accepts; and the heap does not shrink.
        libc::mallopt(libc::M_MMAP_THRESHOLD, 32 << 20);
        libc::mallopt(libc::M_TRIM_THRESHOLD, i32::MAX);
    }
}

/// Turns libtorch's warnings into log lines of level debug. They address authors of PyTorch programs ("call
/// `flatten_parameters()`"), and some come with every call.
pub fn log_warnings() {
    warnings::hear(|text| tracing::debug!("libtorch: {text}"));
}

/// Makes what libtorch refuses, where nothing goes on without it, one line of the log: tch panics there, with the call stack
/// of the C++. To be called once, after logging is set up.
pub fn log_refusals() {
    refusal::say_in_a_line();
}

#[derive(Debug, thiserror::Error)]
pub enum DeviceError {
    #[error("learner.device is \"cuda\" but libtorch finds no CUDA device")]
    NoCuda,
}

/// Picks the device and the arithmetic, and fixes libtorch's thread counts: `threads` within an operation, one between
/// operations. Call it before any tensor is made.
pub(crate) fn choose(config: &LearnerConfig) -> Result<Device, DeviceError> {
    if config.cpu == CpuArithmetic::Fastest {
        arithmetic::use_fastest();
    }
    // libtorch allows this once a process, and not after it has computed.
    if tch::get_num_interop_threads() != 1 {
        tch::set_num_interop_threads(1);
    }
    tch::set_num_threads(config.threads as i32);
    let device = match config.device {
        DeviceChoice::Cpu => Device::Cpu,
        DeviceChoice::Auto => Device::cuda_if_available(),
        DeviceChoice::Cuda if Cuda::is_available() => Device::Cuda(0),
        DeviceChoice::Cuda => return Err(DeviceError::NoCuda),
    };
    if config.deterministic && device.is_cuda() {
        determinism::use_deterministic();
    }
    Ok(device)
}

/// These numbers on a device. They go to a GPU from pinned memory, so that nobody waits: for any other copy libtorch would
/// wait until the GPU has done all that it was given before.
pub(crate) fn upload<T: Element>(numbers: &[T], device: Device) -> Tensor {
    let host = Tensor::from_slice(numbers);
    if !device.is_cuda() || numbers.is_empty() {
        return host.to_device(device);
    }
    // libtorch keeps the pinned memory until the copy is through.
    host.pin_memory(device).to_device_(device, host.kind(), true, false)
}

pub(crate) fn parse_choice(text: &str) -> Result<DeviceChoice, String> {
    match text {
        "cpu" => Ok(DeviceChoice::Cpu),
        "cuda" => Ok(DeviceChoice::Cuda),
        "auto" => Ok(DeviceChoice::Auto),
        _ => Err("must be cpu, cuda or auto".to_owned()),
    }
}

/// Words for logs, events and results: `cpu, 2 threads`, `cuda:0`, or `cuda:0, bfloat16 encoder` where the encoder
/// computes in bfloat16. All else is float32. A device is called as the machine calls it, whatever this process sees.
pub fn describe(device: Device, bfloat16_encoder: bool) -> String {
    let precision = if bfloat16_encoder { ", bfloat16 encoder" } else { "" };
    let place = match device {
        Device::Cpu => match tch::get_num_threads() {
            1 => "cpu, 1 thread".to_owned(),
            threads => format!("cpu, {threads} threads"),
        },
        Device::Cuda(index) => {
            let visible = std::env::var(VISIBLE_DEVICES).ok();
            format!("cuda:{}", device_name(index, visible.as_deref()))
        }
        other => format!("{other:?}").to_lowercase(),
    };
    place + precision
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_say_where_and_in_which_precision() {
        assert!(describe(Device::Cpu, false).starts_with("cpu, ") && !describe(Device::Cpu, false).contains("float"));
        assert_eq!(describe(Device::Cuda(0), false), "cuda:0");
        assert_eq!(describe(Device::Cuda(0), true), "cuda:0, bfloat16 encoder");
    }
}
