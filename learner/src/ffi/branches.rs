//! Work of a stream that divides: branches beside one another, and the stream goes on when all have ended. A recording
//! ([`super::graph`]) takes them in as branches of its graph.

use super::cuda::{self, CudaError, succeed};
use super::library::{Handle, function, open};
use super::stream::{Priority, Stream, StreamError, Streams, exchange};
use std::ffi::{c_int, c_uint};
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::ptr::null_mut;

/// `CU_EVENT_DISABLE_TIMING`: it only orders.
const ORDERS: c_uint = 2;

type Create = unsafe extern "C" fn(*mut Handle, c_uint) -> c_int;
type Record = unsafe extern "C" fn(Handle, Handle) -> c_int;
type Wait = unsafe extern "C" fn(Handle, Handle, c_uint) -> c_int;

/// Streams for branches, and the events that order them. They live as long as the process.
#[derive(Debug)]
pub struct Branches {
    record: Record,
    wait: Wait,
    all: Vec<Branch>,
}

#[derive(Debug)]
struct Branch {
    stream: Stream,
    begins: Handle,
    ends: Handle,
}

impl Branches {
    /// Makes so many. libtorch must have made a tensor on the device before.
    pub fn open(count: usize) -> Result<Self, CudaError> {
        let library = open(&[c"libcuda.so.1"])?;
        let create = function!(library, c"cuEventCreate" as Create);
        let streams = Streams::open()?;
        let event = || {
            let mut event = null_mut();
            // SAFETY: the driver is initialised; the out-pointer is ours.
            succeed("cuEventCreate", unsafe { create(&raw mut event, ORDERS) })?;
            Ok::<_, CudaError>(event)
        };
        let branch = |_| Ok(Branch { stream: streams.make(Priority::High)?, begins: event()?, ends: event()? });
        Ok(Self {
            record: function!(library, c"cuEventRecord" as Record),
            wait: function!(library, c"cuStreamWaitEvent" as Wait),
            all: (0..count).map(branch).collect::<Result<_, CudaError>>()?,
        })
    }

    /// What `work` launches goes to a branch: after all that this thread's stream was given so far, and beside what it
    /// is given later. Tensors of the one must not be freed while the other uses their memory: they are kept until
    /// [`Branches::join`].
    ///
    /// # Panics
    /// If there is no such branch.
    pub fn fork<T>(&self, index: usize, work: impl FnOnce() -> T) -> Result<T, StreamError> {
        let Branch { stream, begins, ends } = &self.all[index];
        self.follow(stream.handle(), *begins, cuda::stream())?;
        let before = exchange(stream.handle() as i64)?;
        // libtorch panics where it refuses: a recording ends on the stream on which it began.
        let done = cuda::on_stream(stream.handle(), || catch_unwind(AssertUnwindSafe(work)));
        exchange(before)?;
        let done = done.unwrap_or_else(|panic| resume_unwind(panic));
        // SAFETY: the event and the stream live as long as the process.
        succeed("cuEventRecord", unsafe { (self.record)(*ends, stream.handle()) })?;
        Ok(done)
    }

    /// What this thread's stream is given from now on comes after the first so many branches, each of which was forked.
    pub fn join(&self, count: usize) -> Result<(), CudaError> {
        for branch in &self.all[..count] {
            // SAFETY: an event that was recorded, and a stream; both live as long as the process.
            succeed("cuStreamWaitEvent", unsafe { (self.wait)(cuda::stream(), branch.ends, 0) })?;
        }
        Ok(())
    }

    /// What `stream` is given from now on comes after what `first` was given so far.
    fn follow(&self, stream: Handle, event: Handle, first: Handle) -> Result<(), CudaError> {
        // SAFETY: events and streams live as long as the process.
        succeed("cuEventRecord", unsafe { (self.record)(event, first) })?;
        // SAFETY: as above.
        succeed("cuStreamWaitEvent", unsafe { (self.wait)(stream, event, 0) })
    }
}
