//! Calls into C and C++ that no crate makes for us, or not the way we need them.

pub mod arithmetic;
pub mod convolution;
pub mod cuda;
pub mod determinism;
pub mod graph;
pub mod group;
pub mod host_memory;
pub mod kernels;
pub mod library;
pub mod nccl;
pub mod stream;
pub mod warnings;

use proto::camera::FRAME_PIXELS;
use std::ffi::{c_char, c_int};
use tch::{Device, Kind, TchError, Tensor};

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

/// The raw bytes that a tensor on the CPU consists of.
///
/// # Panics
/// If it is not contiguous, not on the CPU, or not of bytes.
pub fn bytes_mut(tensor: &mut Tensor) -> &mut [u8] {
    assert!(tensor.device() == Device::Cpu && tensor.kind() == Kind::Uint8 && tensor.is_contiguous());
    // SAFETY: the tensor's memory holds so many bytes and lives as long as the tensor that is borrowed.
    unsafe { std::slice::from_raw_parts_mut(tensor.data_ptr().cast(), tensor.numel()) }
}

/// Calls a function of ours in C++ that takes room for an error's text and its size, and returns 0 or 1 (`guard.h`).
fn guarded(call: impl FnOnce(*mut c_char, usize) -> c_int) -> Result<(), TchError> {
    let mut message = [0; 1024];
    if call(message.as_mut_ptr(), message.len()) == 0 {
        return Ok(());
    }
    let text: Vec<u8> = message.iter().map(|&byte| byte.cast_unsigned()).take_while(|&byte| byte != 0).collect();
    Err(TchError::Torch(String::from_utf8_lossy(&text).into_owned()))
}
