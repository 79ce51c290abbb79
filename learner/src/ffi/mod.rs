//! Calls into C and C++ that no crate makes for us, or not the way we need them.

pub mod arithmetic;
pub mod branches;
pub mod convolution;
pub mod cuda;
pub mod determinism;
mod event;
pub mod gpu;
pub mod graph;
pub mod group;
pub mod host_memory;
pub mod kernels;
pub mod library;
pub mod nccl;
pub mod profiler;
pub mod refusal;
pub mod stopwatch;
pub mod stream;
pub mod warnings;

use proto::camera::{FRAME_PIXELS, FRAME_SIDE};
use std::ffi::{c_char, c_int};
use tch::{Device, Kind, TchError, Tensor};

/// A 16-bit tensor of raw frames on the CPU that nobody else has: what is written into it is seen by no other tensor.
#[derive(Debug)]
pub struct FrameRoom(Tensor);

impl FrameRoom {
    /// Room for `rows` frames; in pinned memory, which a GPU reads by DMA, if they go to one.
    pub fn new(rows: i64, device: Device) -> Self {
        let side = FRAME_SIDE as i64;
        let room = Tensor::empty([rows, side, side], (Kind::Int16, Device::Cpu));
        Self(if device.is_cuda() { room.pin_memory(device) } else { room })
    }

    pub fn rows(&self) -> i64 {
        self.0.size()[0]
    }

    pub fn frames_mut(&mut self) -> &mut [[u16; FRAME_PIXELS]] {
        let tensor = &self.0;
        assert!(tensor.device() == Device::Cpu && tensor.kind() == Kind::Int16 && tensor.is_contiguous());
        let count = tensor.numel() / FRAME_PIXELS;
        if count == 0 {
            // A tensor of nothing has no memory, and a slice never begins at null.
            return &mut [];
        }
        // SAFETY: the tensor's memory holds so many 16-bit numbers one after another, which libtorch, foreign code, has
        // allocated: it holds some bytes, and every pattern of bits is a number. `new` made the tensor, and it never
        // left `self`, so that no other tensor shares the memory; `self` is borrowed as long as the slice lives. A GPU may
        // read it, through `copy_to` or by its address: whoever starts that waits for the result before the room is
        // written again (`Agent::infer`, `Acting::step`).
        unsafe { std::slice::from_raw_parts_mut(tensor.data_ptr().cast(), count) }
    }

    /// A copy of the first `rows` frames on a GPU. The copy may go on after the call. Panics if the device is the CPU:
    /// nothing would be copied.
    pub fn copy_to(&self, device: Device, rows: i64) -> Tensor {
        assert!(device.is_cuda(), "a copy is made on another device");
        self.0.narrow(0, 0, rows).to_device_(device, Kind::Int16, true, false)
    }

    pub fn into_tensor(self) -> Tensor {
        self.0
    }
}

/// A new tensor of 32-bit floating-point numbers on the CPU. `fill` writes them, row-major; those that it leaves out
/// are whatever was in memory.
pub fn floats(size: &[i64], fill: impl FnOnce(&mut [f32])) -> Tensor {
    let tensor = Tensor::empty(size, (Kind::Float, Device::Cpu));
    assert!(tensor.is_contiguous());
    if tensor.numel() > 0 {
        // SAFETY: the tensor's memory holds so many 32-bit numbers one after another, which libtorch, foreign code, has
        // allocated: it holds some bytes, and every pattern of bits is a number. It is not null, since there are some.
        // No other tensor shares the memory: this one was made above. The slice ends before the tensor is returned.
        fill(unsafe { std::slice::from_raw_parts_mut(tensor.data_ptr().cast(), tensor.numel()) });
    }
    tensor
}

/// The numbers that a 32-bit floating-point tensor on the CPU consists of, row-major.
///
/// # Safety
/// As long as the slice lives, nothing else reads or writes the memory: no other tensor that shares it, and no GPU.
///
/// # Panics
/// If it is not contiguous, not on the CPU, or of another kind.
pub unsafe fn floats_mut(tensor: &mut Tensor) -> &mut [f32] {
    assert!(tensor.device() == Device::Cpu && tensor.kind() == Kind::Float && tensor.is_contiguous());
    if tensor.numel() == 0 {
        return &mut [];
    }
    // SAFETY: the tensor's memory holds so many 32-bit numbers one after another, lives as long as the tensor that is
    // borrowed, and every pattern of bits is a number. That nothing else touches it is the caller's promise.
    unsafe { std::slice::from_raw_parts_mut(tensor.data_ptr().cast(), tensor.numel()) }
}

/// The raw bytes that a tensor on the CPU consists of.
///
/// # Safety
/// As for [`floats_mut`].
///
/// # Panics
/// If it is not contiguous, not on the CPU, or not of bytes.
pub unsafe fn bytes_mut(tensor: &mut Tensor) -> &mut [u8] {
    assert!(tensor.device() == Device::Cpu && tensor.kind() == Kind::Uint8 && tensor.is_contiguous());
    if tensor.numel() == 0 {
        return &mut [];
    }
    // SAFETY: the tensor's memory holds so many bytes and lives as long as the tensor that is borrowed. That nothing
    // else touches it is the caller's promise.
    unsafe { std::slice::from_raw_parts_mut(tensor.data_ptr().cast(), tensor.numel()) }
}

/// Calls a function of ours in C++ that takes room for an error's text and its size, and returns 0 or 1 (`guard.h`).
fn guarded(call: impl FnOnce(*mut c_char, usize) -> c_int) -> Result<(), TchError> {
    let mut message = [0; 1024];
    if call(message.as_mut_ptr(), message.len()) == 0 {
        return Ok(());
    }
    let text: Vec<u8> = message.iter().map(|&byte| byte as u8).take_while(|&byte| byte != 0).collect();
    Err(TchError::Torch(String::from_utf8_lossy(&text).into_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tensor_of_nothing_has_an_empty_slice() {
        assert!(FrameRoom::new(0, Device::Cpu).frames_mut().is_empty());
        let mut called = false;
        assert_eq!(floats(&[0, 3], |_| called = true).size(), [0, 3]);
        assert!(!called, "there is nothing to write");
    }
}
