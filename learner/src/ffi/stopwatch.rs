//! How long parts of a stream's work take on the device, without a wait between them.

use super::cuda::{CudaError, stream, succeed};
use super::event::{Event, Events, Purpose};
use super::library::{Handle, function, open};
use std::cell::{Cell, RefCell};
use std::ffi::{c_float, c_int};

type Synchronize = unsafe extern "C" fn(Handle) -> c_int;
type ElapsedTime = unsafe extern "C" fn(*mut c_float, Handle, Handle) -> c_int;

/// Adds up the time of parts of the work on this thread's stream.
#[derive(Debug)]
pub struct Stopwatch {
    events: Events,
    synchronize: Synchronize,
    elapsed: ElapsedTime,
    /// Beginning and end of each part; used again after a reset.
    parts: RefCell<Vec<[Event; 2]>>,
    measured: Cell<usize>,
}

impl Stopwatch {
    /// Finds the driver's functions. libtorch must have made a tensor on the device before.
    pub fn open() -> Result<Self, CudaError> {
        let library = open(&[c"libcuda.so.1"])?;
        Ok(Self {
            events: Events::open()?,
            synchronize: function!(library, c"cuEventSynchronize" as Synchronize),
            elapsed: function!(library, c"cuEventElapsedTime" as ElapsedTime),
            parts: RefCell::default(),
            measured: Cell::new(0),
        })
    }

    /// Measures what `work` gives this thread's stream; waits for nothing.
    pub fn measure<T, E: From<CudaError>>(&self, work: impl FnOnce() -> Result<T, E>) -> Result<T, E> {
        let part = self.part(self.measured.get())?;
        self.events.record(part[0], stream())?;
        let done = work()?;
        self.events.record(part[1], stream())?;
        self.measured.set(self.measured.get() + 1);
        Ok(done)
    }

    /// Waits for the last part, and returns the time of all since the last reset, s.
    pub fn total_s(&self) -> Result<f64, CudaError> {
        let parts = self.parts.borrow();
        let mut total_s = 0.0;
        for &[began, ended] in &parts[..self.measured.get()] {
            // SAFETY: an event that lives as long as the process.
            succeed("cuEventSynchronize", unsafe { (self.synchronize)(ended.handle()) })?;
            let mut took_ms = 0.0;
            // SAFETY: both have been recorded and reached, on one stream; the out-pointer is ours.
            let code = unsafe { (self.elapsed)(&raw mut took_ms, began.handle(), ended.handle()) };
            succeed("cuEventElapsedTime", code)?;
            total_s += 1e-3 * f64::from(took_ms);
        }
        Ok(total_s)
    }

    pub fn reset(&self) {
        self.measured.set(0);
    }

    fn part(&self, index: usize) -> Result<[Event; 2], CudaError> {
        let mut parts = self.parts.borrow_mut();
        if index == parts.len() {
            parts.push([self.events.make(Purpose::Time)?, self.events.make(Purpose::Time)?]);
        }
        Ok(parts[index])
    }
}
