//! CUDA graphs: many launches recorded once and then made by one call (`graph.cpp`).

use super::cuda::{self, CudaError};
use super::guarded;
use super::library::{Handle, function, open};
use super::refusal;
use super::stream::{Priority, Stream, StreamError, Streams, exchange};
use proto::fault;
use std::ffi::{c_char, c_int};
use std::ptr::null_mut;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use tch::{Cuda, TchError};

/// Why nothing was recorded.
#[derive(Debug, thiserror::Error)]
pub enum GraphError {
    /// The driver, or a library, refuses.
    #[error(transparent)]
    Cuda(#[from] CudaError),
    /// libtorch refuses.
    #[error(transparent)]
    Torch(#[from] TchError),
    /// Work cannot be given to another stream.
    #[error(transparent)]
    Stream(#[from] StreamError),
    /// An operation cannot be recorded. This is libtorch's reason.
    #[error("an operation cannot be recorded: {0}")]
    Operation(String),
}

/// Members of `at::cuda::CUDAGraph`, in the order of `GraphFunctions` in graph.cpp.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
struct Functions {
    construct: Member,
    destroy: Member,
    begin: Member,
    end: Member,
    replay: Member,
}

type Member = unsafe extern "C" fn();

unsafe extern "C" {
    fn stillroom_graph_begin(
        functions: *const Functions,
        pool: u64,
        graph: *mut Handle,
        message: *mut c_char,
        capacity: usize,
    ) -> c_int;
    fn stillroom_graph_end(functions: *const Functions, graph: Handle, message: *mut c_char, capacity: usize) -> c_int;
    fn stillroom_graph_replay(
        functions: *const Functions,
        graph: Handle,
        message: *mut c_char,
        capacity: usize,
    ) -> c_int;
    fn stillroom_graph_destroy(
        functions: *const Functions,
        graph: Handle,
        message: *mut c_char,
        capacity: usize,
    ) -> c_int;
}

/// Where what a graph computes lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Memory {
    /// Each graph has its own.
    Apart,
    /// All graphs of a recorder have the same, as if their work were done in the order in which they were recorded: what
    /// one of them computed and nobody holds any more may be overwritten by the next. They are to be launched one after
    /// the other. One may be dropped, and what it had of the memory is used again, but not the last one before another is
    /// recorded: libtorch takes up no memory that no graph uses.
    Shared,
}

/// Pools of memory that graphs share. libtorch counts its own from 1, process by process.
static POOLS: AtomicU64 = AtomicU64::new(1 << 32);

/// Held by the thread that records, or that waits for the device.
static RECORDING: Mutex<()> = Mutex::new(());

/// Until the guard is dropped no other thread records, or waits for the device: while one thread records, another one
/// that waits for the device gets CUDA error 900, and the recording ends with 901 (seen on an H100). Waiting for a stream
/// or an event, launches and allocations do no harm.
fn alone() -> MutexGuard<'static, ()> {
    // Nothing lies behind the lock that a panic could leave half done.
    RECORDING.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Waits until a device has done all that it was given, by all threads. The one way to do so outside of this file.
pub fn wait_for_device(index: usize) {
    let _alone = alone();
    synchronize(index);
}

#[expect(clippy::disallowed_methods, reason = "no other thread records, as the callers see to")]
fn synchronize(index: usize) {
    Cuda::synchronize(index as i64);
}

/// Records graphs.
#[derive(Debug)]
pub struct Recorder {
    functions: Functions,
    /// libtorch's number of the memory that all graphs share; 0 where each has its own.
    pool: u64,
    /// A stream of our own, because nothing can be recorded on the default stream.
    stream: Stream,
    streams: Streams,
}

/// A recorded graph of the first CUDA device.
#[derive(Debug)]
pub struct Graph {
    functions: Functions,
    graph: Handle,
}

// SAFETY: the driver's functions take a stream from any thread; libtorch's are stateless.
unsafe impl Send for Recorder {}
// SAFETY: a graph is launched, and freed, by whoever has it, one thread at a time.
unsafe impl Send for Graph {}

impl Recorder {
    /// Finds libtorch's functions and makes a stream, whose priority the kernels of its graphs keep. libtorch must have
    /// made a tensor on the device before.
    pub fn open(priority: Priority, memory: Memory) -> Result<Self, GraphError> {
        let pool = match memory {
            Memory::Apart => 0,
            Memory::Shared => POOLS.fetch_add(1, Ordering::Relaxed),
        };
        let streams = Streams::open()?;
        Ok(Self { functions: functions()?, pool, stream: streams.make(priority)?, streams })
    }

    /// Runs `body` a few times, because libraries choose their algorithms and allocate their room at first use, which a
    /// recording does not allow; then records what it launches, which must be the same every time. Its results are in
    /// the memory that it writes, which must live as long as the graph.
    ///
    /// Waits for other threads that record. `body` must not wait for the device, nor record. After an error, a recorder whose
    /// graphs share memory records again only while one of its graphs is left, see [`Memory::Shared`].
    pub fn record<T>(
        &self,
        warm_ups: usize,
        mut body: impl FnMut() -> Result<T, GraphError>,
    ) -> Result<(Graph, T), GraphError> {
        let _alone = alone();
        synchronize(0);
        let before = exchange(self.stream.handle() as i64)?;
        let recorded = cuda::on_stream(self.stream.handle(), || {
            let mut try_body =
                || refusal::caught(&mut body).unwrap_or_else(|reason| Err(GraphError::Operation(reason)));
            for _ in 0..warm_ups {
                try_body()?;
                synchronize(0);
            }
            let functions = self.functions;
            let mut recording = null_mut();
            // SAFETY: the functions are libtorch's; the out-pointer is ours.
            guarded(|message, capacity| unsafe {
                stillroom_graph_begin(&raw const functions, self.pool, &raw mut recording, message, capacity)
            })?;
            if fault::fails("learner.recording") {
                // What no recording allows: it is void from here on, as after any operation that cannot be recorded.
                let _ = self.streams.wait();
            }
            let result = try_body();
            // In any case, or the stream would stay in the state of recording.
            let graph = self.end(recording).inspect_err(|_| self.give_up(recording));
            let result = result?;
            Ok((graph?, result))
        });
        exchange(before)?;
        synchronize(0);
        recorded
    }

    /// Ends what was begun on this thread's stream.
    fn end(&self, recording: Handle) -> Result<Graph, GraphError> {
        let functions = self.functions;
        // SAFETY: the caller has begun it.
        guarded(|message, capacity| unsafe {
            stillroom_graph_end(&raw const functions, recording, message, capacity)
        })?;
        Ok(Graph { functions, graph: recording })
    }

    /// Gives back what a recording that the driver voided took of the device's memory. libtorch's function stops where the
    /// driver refuses, and its allocator and its generator of random numbers go on as if something were being recorded: that
    /// memory stays taken, no cached block is freed where memory runs out, and no random number is drawn. So the same function
    /// ends an empty recording.
    ///
    /// Where that fails, too, the recording is never freed, because the allocator may still ask it which streams it records.
    /// Where libtorch had ended the recording and only could not make a graph of it, the memory is lost for nothing: the two
    /// are not told apart here.
    fn give_up(&self, recording: Handle) {
        let begun = self.streams.begin_capture(self.stream).map_err(GraphError::from);
        match begun.and_then(|()| self.end(recording)) {
            Ok(empty) => drop(empty),
            Err(error) => tracing::debug!("the memory of a recording that failed is lost: {error}"),
        }
    }

    /// Waits until all graphs that this thread has launched are through: one that may still run is not to be dropped.
    pub fn wait(&self) -> Result<(), GraphError> {
        Ok(self.streams.wait()?)
    }
}

impl Graph {
    /// Launches what was recorded, on the current stream.
    pub fn replay(&self) -> Result<(), GraphError> {
        // SAFETY: a graph that was recorded to its end.
        Ok(guarded(|message, capacity| unsafe {
            stillroom_graph_replay(&raw const self.functions, self.graph, message, capacity)
        })?)
    }
}

impl Drop for Graph {
    fn drop(&mut self) {
        // SAFETY: made by libtorch, and not used afterwards.
        let destroyed = guarded(|message, capacity| unsafe {
            stillroom_graph_destroy(&raw const self.functions, self.graph, message, capacity)
        });
        if let Err(error) = destroyed {
            tracing::debug!("a CUDA graph is not freed: {error}");
        }
    }
}

/// Members of the class, by the names that the compiler gives them: torch 2.11's are declared in
/// `ATen/cuda/CUDAGraph.h`.
fn functions() -> Result<Functions, CudaError> {
    let library = open(&[c"libtorch_cuda.so"])?;
    Ok(Functions {
        construct: function!(library, c"_ZN2at4cuda9CUDAGraphC1Eb" as Member),
        destroy: function!(library, c"_ZN2at4cuda9CUDAGraphD1Ev" as Member),
        begin: function!(library, c"_ZN2at4cuda9CUDAGraph13capture_beginESt4pairIyyE21cudaStreamCaptureMode" as Member),
        end: function!(library, c"_ZN2at4cuda9CUDAGraph11capture_endEv" as Member),
        replay: function!(library, c"_ZN2at4cuda9CUDAGraph6replayEv" as Member),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicU32;
    use std::time::Duration;
    use tch::{Device, Kind, Tensor};

    /// After it libtorch's allocator frees memory, its generator draws random numbers, and others record.
    #[test]
    #[ignore = "needs a CUDA device"]
    fn a_recording_that_failed_gives_its_memory_back() {
        let _alone = crate::device::cuda_alone();
        let on_device = (Kind::Uint8, Device::Cuda(0));
        let room = |gib: i64| Tensor::f_empty([gib << 30], on_device);
        for memory in [Memory::Apart, Memory::Shared] {
            assert!(room(1 << 20).is_err(), "in vain, but libtorch has freed what it had cached");
            let recorder = Recorder::open(Priority::Low, memory).unwrap();
            let mut most = 0;
            let void = recorder.record(0, || {
                // So large that no second one fits.
                most = (0..10).rev().map(|power| 1 << power).find(|&gib| room(gib).is_ok()).unwrap();
                recorder.wait()
            });
            assert!(void.is_err() && most > 0, "{void:?}, {most} GiB");
            let again = room(most);
            assert!(again.is_ok(), "{most} GiB: {again:?}");
            let random = Tensor::f_rand([2], (Kind::Float, Device::Cuda(0)));
            assert!(random.is_ok(), "{random:?}");
            let other = Recorder::open(Priority::Low, memory).unwrap();
            let (graph, ones) = other.record(0, || Ok(Tensor::ones([2], on_device))).unwrap();
            graph.replay().unwrap();
            assert_eq!(Vec::<u8>::try_from(ones).unwrap(), [1, 1]);
        }
    }

    #[test]
    fn two_threads_never_record_at_a_time_and_a_panic_locks_nobody_out() {
        let (inside, most) = (AtomicU32::new(0), AtomicU32::new(0));
        let record = || {
            let _alone = alone();
            most.fetch_max(inside.fetch_add(1, Ordering::SeqCst) + 1, Ordering::SeqCst);
            std::thread::sleep(Duration::from_millis(2));
            inside.fetch_sub(1, Ordering::SeqCst);
            panic!("libtorch refuses");
        };
        std::thread::scope(|scope| {
            let threads: Vec<_> = (0..8).map(|_| scope.spawn(record)).collect();
            assert!(threads.into_iter().all(|thread| thread.join().is_err()), "each came in, and panicked there");
        });
        assert_eq!(most.into_inner(), 1);
    }
}
