//! Places in the work of streams, for whoever orders it or times it.

use super::cuda::{CudaError, succeed};
use super::library::{Handle, function, open};
use std::ffi::{c_int, c_uint};
use std::ptr::null_mut;

type Create = unsafe extern "C" fn(*mut Handle, c_uint) -> c_int;
type Record = unsafe extern "C" fn(Handle, Handle) -> c_int;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Purpose {
    /// It notes the time when the device gets there (`CU_EVENT_DEFAULT`).
    Time = 0,
    /// Others wait for it (`CU_EVENT_DISABLE_TIMING`).
    Order = 2,
}

#[derive(Debug, Clone, Copy)]
pub(super) struct Events {
    create: Create,
    record: Record,
}

/// A place in a stream's work. It lives as long as the process.
#[derive(Debug, Clone, Copy)]
pub(super) struct Event(Handle);

impl Events {
    /// Finds them. libtorch must have made a tensor on the device before.
    pub fn open() -> Result<Self, CudaError> {
        let library = open(&[c"libcuda.so.1"])?;
        Ok(Self {
            create: function!(library, c"cuEventCreate" as Create),
            record: function!(library, c"cuEventRecord" as Record),
        })
    }

    pub fn make(self, purpose: Purpose) -> Result<Event, CudaError> {
        let mut event = null_mut();
        // SAFETY: the driver is initialised; the out-pointer is ours.
        succeed("cuEventCreate", unsafe { (self.create)(&raw mut event, purpose as c_uint) })?;
        Ok(Event(event))
    }

    /// It is now after all that the stream was given so far. The stream must live as long as the process.
    pub fn record(self, event: Event, stream: Handle) -> Result<(), CudaError> {
        // SAFETY: the event and the stream live as long as the process.
        succeed("cuEventRecord", unsafe { (self.record)(event.0, stream) })
    }
}

impl Event {
    /// As the driver knows it.
    pub fn handle(self) -> Handle {
        self.0
    }
}
