//! Whether a GPU can read what actors wrote where they wrote it.

use crate::ffi::cuda::CudaError;
use crate::ffi::host_memory::HostMemory;

#[derive(Debug)]
pub(super) struct Reach {
    memory: HostMemory,
    /// Something lay out of reach, and a warning was given.
    pub(super) missed: bool,
}

impl Reach {
    pub fn open() -> Result<Self, CudaError> {
        Ok(Self { memory: HostMemory::open()?, missed: false })
    }

    /// Actors have started again: what they write may lie where others' lay.
    pub fn recheck(&mut self) {
        self.memory.recheck();
    }

    /// Whether all of these are in reach, each so many bytes at an address.
    pub fn covers(&mut self, mut pieces: impl Iterator<Item = (usize, usize)>) -> bool {
        let Err(why) = pieces.try_for_each(|(address, bytes)| self.memory.admit(address, bytes)) else { return true };
        if !std::mem::replace(&mut self.missed, true) {
            tracing::warn!(
                "acting copies frames for the GPU, which takes longer, as it cannot read them where they are: {why}"
            );
        }
        false
    }
}
