//! Work of a stream that divides: branches beside one another, and the stream goes on when all have ended. A recording
//! ([`super::graph`]) takes them in as branches of its graph.

use super::cuda::{self, CudaError, succeed};
use super::event::{Event, Events, Purpose};
use super::library::{Handle, function, open};
use super::stream::{Priority, Stream, StreamError, Streams, exchange};
use std::cell::Cell;
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

    /// Runs `work`, which may fork branches; what this thread's stream is given afterwards comes after all of those.
    /// They are joined also where `work` fails or panics: a recording does not end while one is open.
    ///
    /// Tensors of a branch must not be freed while others use their memory: `work` returns what is needed later.
    pub fn joined<T, E: From<CudaError>>(&self, work: impl FnOnce(&Forks) -> Result<T, E>) -> Result<T, E> {
        let forks = Forks { branches: self, begun: Cell::new(0) };
        let done = catch_unwind(AssertUnwindSafe(|| work(&forks)));
        let joined = forks.join();
        let done = done.unwrap_or_else(|panic| resume_unwind(panic))?;
        joined?;
        Ok(done)
    }

    /// What `stream` is given from now on comes after an event that was recorded.
    fn wait(&self, stream: Handle, event: Event) -> Result<(), CudaError> {
        // SAFETY: events and streams live as long as the process.
        succeed("cuStreamWaitEvent", unsafe { (self.wait)(stream, event.handle(), 0) })
    }
}

#[derive(Debug)]
pub struct Forks<'a> {
    branches: &'a Branches,
    begun: Cell<usize>,
}

impl Forks<'_> {
    /// What `work` launches goes to a branch of its own: after all that this thread's stream was given so far, and
    /// beside what it is given later. Panics if there are not so many branches.
    pub fn fork<T>(&self, work: impl FnOnce() -> T) -> Result<T, StreamError> {
        let Branches { events, all, .. } = self.branches;
        let &Branch { stream, begins, ends } = &all[self.begun.get()];
        events.record(begins, cuda::stream())?;
        self.branches.wait(stream.handle(), begins)?;
        self.begun.set(self.begun.get() + 1);
        let before = exchange(stream.handle() as i64)?;
        // libtorch panics where it refuses: a recording ends on the stream on which it began.
        let done = cuda::on_stream(stream.handle(), || catch_unwind(AssertUnwindSafe(work)));
        let restored = exchange(before);
        let ended = events.record(ends, stream.handle());
        let done = done.unwrap_or_else(|panic| resume_unwind(panic));
        restored?;
        ended?;
        Ok(done)
    }

    fn join(&self) -> Result<(), CudaError> {
        let begun = &self.branches.all[..self.begun.get()];
        // Each of them, whatever becomes of the others.
        begun.iter().map(|branch| self.branches.wait(cuda::stream(), branch.ends)).fold(Ok(()), Result::and)
    }
}
