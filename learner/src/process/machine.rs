//! What this process computes with: the things that the last bits of a result depend on.

use crate::ffi::arithmetic;
use proto::checkpoint::Machine;
use proto::config::LearnerConfig;
use std::path::{Path, PathBuf};
use tch::Device;

/// Version of libtorch that this program is written for.
pub const TORCH_VERSION: &str = "2.11.0";

/// The name of the arithmetic that is the same on every x86-64 processor with AVX2; on ARM its bits are others.
const REPRODUCIBLE: &str = if cfg!(target_arch = "aarch64") { "neon" } else { "reproducible" };

pub fn machine(device: Device, LearnerConfig { threads, count, shards, .. }: LearnerConfig) -> Machine {
    Machine {
        torch: torch_version().unwrap_or_else(|| "unknown".to_owned()),
        device: if device.is_cuda() { "cuda" } else { "cpu" }.to_owned(),
        threads,
        arithmetic: arithmetic(),
        learners: count,
        shards,
    }
}

/// Version of the libtorch that is loaded, without a build suffix; none if it is unknown. The library has no function
/// for it; each distribution has a file beside its `lib` folder.
pub fn torch_version() -> Option<String> {
    let folder = torch_library()?.parent()?.parent()?.to_path_buf();
    let text = std::fs::read_to_string(folder.join("build-version"))
        .ok()
        .or_else(|| python_version(&std::fs::read_to_string(folder.join("version.py")).ok()?))?;
    let version = text.trim().split('+').next()?;
    (!version.is_empty()).then(|| version.to_owned())
}

pub fn torch_library() -> Option<PathBuf> {
    let maps = std::fs::read_to_string("/proc/self/maps").ok()?;
    // The path is the sixth field and may hold spaces.
    let path = maps.lines().find_map(|line| {
        let path = &line[line.find('/')?..];
        path.ends_with("/libtorch_cpu.so").then_some(path)
    })?;
    Some(Path::new(path).to_path_buf())
}

/// `__version__ = '2.11.0+cpu'` in torch's version.py.
fn python_version(text: &str) -> Option<String> {
    let line = text.lines().find(|line| line.starts_with("__version__"))?;
    line.split(['\'', '"']).nth(1).map(str::to_owned)
}

/// What the last bits of the CPU's results depend on: `reproducible` where they are the same on every processor,
/// otherwise the instruction set that libtorch picks its kernels by, found by its own rule
/// (`ATen/native/DispatchStub.cpp`).
fn arithmetic() -> String {
    if arithmetic::is_reproducible() {
        return REPRODUCIBLE.to_owned();
    }
    if let Ok(chosen) = std::env::var("ATEN_CPU_CAPABILITY") {
        return chosen;
    }
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::is_x86_feature_detected;
        if is_x86_feature_detected!("avx512vl")
            && is_x86_feature_detected!("avx512bw")
            && is_x86_feature_detected!("avx512dq")
            && is_x86_feature_detected!("fma")
        {
            return "avx512".to_owned();
        }
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            return "avx2".to_owned();
        }
    }
    std::env::consts::ARCH.to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_loaded_library_tells_its_version() {
        // Anything that makes the linker keep libtorch.
        let _ = tch::get_num_threads();
        assert_eq!(torch_version().as_deref(), Some(TORCH_VERSION));
        assert_eq!(python_version("debug = False\n__version__ = '2.11.0+cpu'\n").as_deref(), Some("2.11.0+cpu"));
    }
}
