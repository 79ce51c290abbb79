//! Calls into C that no crate makes for us.

pub mod convolution;
pub mod cuda;
pub mod kernels;

use proto::message::FRAME_PIXELS;
use std::ffi::CStr;
use tch::{Device, Kind, Tensor};

/// Loads a shared library for the rest of the process, its symbols visible to all others. False if it is not found.
pub fn load_library_globally(file: &CStr) -> bool {
    // SAFETY: `file` is a C string that outlives the call. The library's initialisers run here: the caller names
    // libraries that are meant to be loaded this way.
    let handle = unsafe { libc::dlopen(file.as_ptr(), libc::RTLD_NOW | libc::RTLD_GLOBAL) };
    !handle.is_null()
}

/// The raw frames that a 16-bit tensor on the CPU consists of.
///
/// # Panics
/// If it is not contiguous, not on the CPU, not 16-bit, or not made of whole frames.
pub fn frames_mut(tensor: &mut Tensor) -> &mut [[u16; FRAME_PIXELS]] {
    let count = tensor.numel();
    assert!(tensor.device() == Device::Cpu && tensor.kind() == Kind::Int16 && tensor.is_contiguous());
    assert!(count.is_multiple_of(FRAME_PIXELS), "whole frames");
    // SAFETY: the tensor's memory holds so many 16-bit numbers one after another, lives as long as the tensor that is
    // borrowed, and every pattern of bits is a number.
    unsafe { std::slice::from_raw_parts_mut(tensor.data_ptr().cast(), count / FRAME_PIXELS) }
}

/// The numbers that a 32-bit floating-point tensor on the CPU consists of, row-major.
///
/// # Panics
/// If it is not contiguous, not on the CPU, or of another kind.
pub fn floats_mut(tensor: &mut Tensor) -> &mut [f32] {
    assert!(tensor.device() == Device::Cpu && tensor.kind() == Kind::Float && tensor.is_contiguous());
    // SAFETY: the tensor's memory holds so many 32-bit numbers one after another, lives as long as the tensor that is
    // borrowed, and every pattern of bits is a number.
    unsafe { std::slice::from_raw_parts_mut(tensor.data_ptr().cast(), tensor.numel()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_library_is_no_crash() {
        assert!(load_library_globally(c"libm.so.6"));
        assert!(!load_library_globally(c"libthere-is-no-such-thing.so"));
    }
}
