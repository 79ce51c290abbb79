//! Streams of a GPU: work on one waits for nothing on another.

use super::cuda::{self, CudaError, succeed};
use super::guarded;
use super::library::{Handle, function, open};
use std::ffi::{c_char, c_int, c_uint};
use std::ptr::null_mut;
use tch::TchError;

/// `CU_STREAM_NON_BLOCKING`: not ordered with the default stream.
const NON_BLOCKING: c_uint = 1;
/// `CU_STREAM_CAPTURE_MODE_THREAD_LOCAL`: what other threads do meanwhile is their own.
const CAPTURE_THIS_THREAD: c_int = 1;

type CreateWithPriority = unsafe extern "C" fn(*mut Handle, c_uint, c_int) -> c_int;
type PriorityRange = unsafe extern "C" fn(*mut c_int, *mut c_int) -> c_int;
type BeginCapture = unsafe extern "C" fn(Handle, c_int) -> c_int;
type Synchronize = unsafe extern "C" fn(Handle) -> c_int;

unsafe extern "C" {
    fn stillroom_exchange_stream(stream: i64, before: *mut i64, message: *mut c_char, capacity: usize) -> c_int;
}

/// Whose work comes first where both are ready.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Priority {
    High,
    Low,
}

#[derive(Debug, Clone, Copy)]
pub struct Streams {
    create: CreateWithPriority,
    range: PriorityRange,
    begin_capture: BeginCapture,
    synchronize: Synchronize,
}

/// A stream. It lives as long as the process.
#[derive(Debug, Clone, Copy)]
pub struct Stream(Handle);

// SAFETY: the driver's functions take a stream from any thread.
unsafe impl Send for Stream {}

#[derive(Debug, thiserror::Error)]
pub enum StreamError {
    #[error(transparent)]
    Cuda(#[from] CudaError),
    #[error(transparent)]
    Torch(#[from] TchError),
}

impl Streams {
    /// Finds them. libtorch must have made a tensor on the device before.
    pub fn open() -> Result<Self, CudaError> {
        let library = open(&[c"libcuda.so.1"])?;
        Ok(Self {
            create: function!(library, c"cuStreamCreateWithPriority" as CreateWithPriority),
            range: function!(library, c"cuCtxGetStreamPriorityRange" as PriorityRange),
            begin_capture: function!(library, c"cuStreamBeginCapture_v2" as BeginCapture),
            synchronize: function!(library, c"cuStreamSynchronize" as Synchronize),
        })
    }

    pub fn make(self, priority: Priority) -> Result<Stream, CudaError> {
        let (mut least, mut greatest) = (0, 0);
        // SAFETY: the driver is initialised; the out-pointers are ours.
        succeed("cuCtxGetStreamPriorityRange", unsafe { (self.range)(&raw mut least, &raw mut greatest) })?;
        let priority = if priority == Priority::High { greatest } else { least };
        let mut stream = null_mut();
        // SAFETY: as above.
        let code = unsafe { (self.create)(&raw mut stream, NON_BLOCKING, priority) };
        succeed("cuStreamCreateWithPriority", code)?;
        Ok(Stream(stream))
    }

    /// From now on what the stream is given is recorded and not done.
    pub(super) fn begin_capture(self, stream: Stream) -> Result<(), CudaError> {
        // SAFETY: the stream lives as long as the process.
        succeed("cuStreamBeginCapture", unsafe { (self.begin_capture)(stream.0, CAPTURE_THIS_THREAD) })
    }

    pub fn wait(self) -> Result<(), CudaError> {
        // SAFETY: the default stream, or one that lives as long as the process.
        succeed("cuStreamSynchronize", unsafe { (self.synchronize)(cuda::stream()) })
    }
}

impl Stream {
    /// What this thread computes goes there from now on.
    pub fn take(self) -> Result<(), StreamError> {
        exchange(self.0 as i64)?;
        cuda::set_stream(self.0);
        Ok(())
    }

    /// As the driver knows it.
    pub(super) fn handle(self) -> Handle {
        self.0
    }
}

/// Makes a stream libtorch's current one on this thread and returns the one that was.
pub(super) fn exchange(stream: i64) -> Result<i64, TchError> {
    let mut before = 0;
    // SAFETY: the out-pointer is ours.
    guarded(|message, capacity| unsafe { stillroom_exchange_stream(stream, &raw mut before, message, capacity) })?;
    Ok(before)
}
