//! Work of a stream that divides: branches beside one another, and the stream goes on when all have ended. A recording
//! ([`super::graph`]) takes them in as branches of its graph.

use super::cuda::{self, CudaError, succeed};
use super::event::{Event, Events, Purpose};
use super::library::{Handle, function, open};
use super::stream::{Priority, Stream, StreamError, Streams, exchange};
use std::ffi::{c_int, c_uint};
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};

type Wait = unsafe extern "C" fn(Handle, Handle, c_uint) -> c_int;

/// Streams for branches, and the events that order them. They live as long as the process.
#[derive(Debug)]
pub struct Branches {
    events: Events,
    wait: Wait,
    all: Vec<Branch>,
}

#[derive(Debug)]
struct Branch {
    stream: Stream,
    begins: Event,
    ends: Event,
}

impl Branches {
    /// Makes so many. libtorch must have made a tensor on the device before.
    pub fn open(count: usize) -> Result<Self, CudaError> {
        let library = open(&[c"libcuda.so.1"])?;
        let (events, streams) = (Events::open()?, Streams::open()?);
        let event = || events.make(Purpose::Order);
        let branch = |_| Ok(Branch { stream: streams.make(Priority::High)?, begins: event()?, ends: event()? });
        Ok(Self {
            events,
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
        let &Branch { stream, begins, ends } = &self.all[index];
        self.events.record(begins, cuda::stream())?;
        self.wait(stream.handle(), begins)?;
        let before = exchange(stream.handle() as i64)?;
        // libtorch panics where it refuses: a recording ends on the stream on which it began.
        let done = cuda::on_stream(stream.handle(), || catch_unwind(AssertUnwindSafe(work)));
        exchange(before)?;
        let done = done.unwrap_or_else(|panic| resume_unwind(panic));
        self.events.record(ends, stream.handle())?;
        Ok(done)
    }

    /// What this thread's stream is given from now on comes after the first so many branches, each of which was forked.
    pub fn join(&self, count: usize) -> Result<(), CudaError> {
        self.all[..count].iter().try_for_each(|branch| self.wait(cuda::stream(), branch.ends))
    }

    /// What `stream` is given from now on comes after an event that was recorded.
    fn wait(&self, stream: Handle, event: Event) -> Result<(), CudaError> {
        // SAFETY: events and streams live as long as the process.
        succeed("cuStreamWaitEvent", unsafe { (self.wait)(stream, event.handle(), 0) })
    }
}
