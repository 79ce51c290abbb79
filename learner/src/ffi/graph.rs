//! CUDA graphs: many launches recorded once and then made by one call (`graph.cpp`).

use super::cuda::{self, CudaError};
use super::guarded;
use super::library::{Handle, function, open};
use super::refusal;
use super::stream::{Priority, Stream, StreamError, Streams, exchange};
use proto::fault;
use std::cell::RefCell;
use std::ffi::{c_char, c_int};
use std::mem::ManuallyDrop;
use std::ptr::null_mut;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use tch::{Cuda, TchError};

#[derive(Debug, thiserror::Error)]
pub enum GraphError {
    #[error(transparent)]
    Cuda(#[from] CudaError),
    #[error(transparent)]
    Torch(#[from] TchError),
    #[error(transparent)]
    Stream(#[from] StreamError),
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
    pool: Member,
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
    fn stillroom_graph_ended(
        functions: *const Functions,
        graph: Handle,
        message: *mut c_char,
        capacity: usize,
    ) -> c_int;
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

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Memory {
    Apart,
    /// All graphs of a recorder have the same, as if their work were done in the order in which they were recorded: what
    /// one of them computed and nobody holds any more may be overwritten by the next. They are to be launched one after
    /// the other. One may be dropped, and what it had of the memory is used again by those recorded later. After the last one
    /// the next has new memory, and libtorch frees the old when memory runs out, though not during a recording.
    Shared,
}

/// Memory that graphs share, by libtorch's number for it. Each of them holds it, because libtorch does not take up again a
/// number that no graph uses any more.
#[derive(Debug)]
struct Pool(u64);

impl Pool {
    fn new() -> Self {
        // libtorch counts its own from 1, process by process: ours never meet them.
        static NEXT: AtomicU64 = AtomicU64::new(1 << 32);
        Self(NEXT.fetch_add(1, Ordering::Relaxed))
    }
}

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

#[derive(Debug)]
pub struct Recorder {
    functions: Functions,
    /// What the graphs share, as long as there are some; none where each has its own.
    pool: Option<RefCell<Weak<Pool>>>,
    /// A stream of our own, because nothing can be recorded on the default stream.
    stream: Stream,
    streams: Streams,
}

/// A recorded graph of the first CUDA device.
#[derive(Debug)]
pub struct Graph {
    functions: Functions,
    handle: Handle,
    _pool: Option<Arc<Pool>>,
}

// SAFETY: the driver's functions take a stream from any thread; libtorch's are stateless.
unsafe impl Send for Recorder {}
// SAFETY: a graph is launched, and freed, by whoever has it, one thread at a time.
unsafe impl Send for Graph {}

impl Recorder {
    /// Finds libtorch's functions and makes a stream, whose priority the kernels of its graphs keep. libtorch must have
    /// made a tensor on the device before.
    pub fn open(priority: Priority, memory: Memory) -> Result<Self, GraphError> {
        let pool = (memory == Memory::Shared).then(RefCell::default);
        let streams = Streams::open()?;
        Ok(Self { functions: functions()?, pool, stream: streams.make(priority)?, streams })
    }

    /// Runs `body` a few times, because libraries choose their algorithms and allocate their room at first use, which a
    /// recording does not allow; then records what it launches, which must be the same every time. Its results are in
    /// the memory that it writes, which must live as long as the graph.
    ///
    /// Waits for other threads that record. `body` must not wait for the device, nor record.
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
            let graph = self.begin()?;
            if fault::fails("learner.recording") {
                // What no recording allows: it is void from here on, as after any operation that cannot be recorded.
                let _ = self.streams.wait();
            }
            let result = try_body();
            // In any case, or the stream would stay in the state of recording.
            let ended = self.end(&graph);
            if let Err(error) = ended {
                self.give_up(graph);
                return Err(result.err().unwrap_or(error));
            }
            let graph = ManuallyDrop::into_inner(graph);
            Ok((graph, result?))
        });
        exchange(before)?;
        synchronize(0);
        recorded
    }

    /// From now on what goes to this thread's stream is recorded. A graph that is not ended must not be dropped.
    fn begin(&self) -> Result<ManuallyDrop<Graph>, GraphError> {
        let functions = self.functions;
        let pool = self.pool.as_ref().map(|pool| {
            let mut used = pool.borrow_mut();
            used.upgrade().unwrap_or_else(|| {
                let pool = Arc::new(Pool::new());
                *used = Arc::downgrade(&pool);
                pool
            })
        });
        let number = pool.as_ref().map_or(0, |pool| pool.0);
        let mut handle = null_mut();
        // Where it fails, the graph stays: libtorch's destructor ends the process if the generator has not met the graph.
        // SAFETY: the functions are libtorch's; the out-pointer is ours.
        guarded(|message, capacity| unsafe {
            stillroom_graph_begin(&raw const functions, number, &raw mut handle, message, capacity)
        })?;
        Ok(ManuallyDrop::new(Graph { functions, handle, _pool: pool }))
    }

    /// Ends what was begun on this thread's stream.
    fn end(&self, graph: &Graph) -> Result<(), GraphError> {
        // SAFETY: the caller has begun it.
        Ok(guarded(|message, capacity| unsafe {
            stillroom_graph_end(&raw const self.functions, graph.handle, message, capacity)
        })?)
    }

    /// Gives back what a recording that came to nothing took of the device's memory.
    ///
    /// Where the driver voided the recording, libtorch's function has stopped there, and its allocator and its generator of
    /// random numbers go on as if something were being recorded: that memory stays taken, no cached block is freed where
    /// memory runs out, and no random number is drawn. So the same function ends an empty recording. Where that fails, too,
    /// the graph is never freed, because the allocator may still ask it which streams it records.
    fn give_up(&self, graph: ManuallyDrop<Graph>) {
        let end_empty = || {
            self.streams.begin_capture(self.stream)?;
            self.end(&graph)
        };
        let ended = if graph.is_ended() { Ok(()) } else { end_empty() };
        match ended {
            Err(error) if !graph.is_ended() => {
                tracing::debug!("the memory of a recording that failed is lost: {error}");
                // libtorch holds that something is being recorded into it.
                if let Some(pool) = &self.pool {
                    pool.replace(Weak::new());
                }
            }
            _ => drop(ManuallyDrop::into_inner(graph)),
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
            stillroom_graph_replay(&raw const self.functions, self.handle, message, capacity)
        })?)
    }

    /// Whether the recording is over, even if the driver could not instantiate the graph.
    fn is_ended(&self) -> bool {
        // SAFETY: a graph that was begun.
        let ended = guarded(|message, capacity| unsafe {
            stillroom_graph_ended(&raw const self.functions, self.handle, message, capacity)
        });
        ended.is_ok()
    }
}

impl Drop for Graph {
    fn drop(&mut self) {
        // SAFETY: made by libtorch, and not used afterwards.
        let destroyed = guarded(|message, capacity| unsafe {
            stillroom_graph_destroy(&raw const self.functions, self.handle, message, capacity)
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
        pool: function!(library, c"_ZN2at4cuda9CUDAGraph4poolEv" as Member),
        replay: function!(library, c"_ZN2at4cuda9CUDAGraph6replayEv" as Member),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicU32;
    use std::time::Duration;
    use tch::{Device, Kind, Tensor};

    const BYTES: (Kind, Device) = (Kind::Uint8, Device::Cuda(0));

    fn room(gib: i64) -> Result<Tensor, TchError> {
        Tensor::f_empty([gib << 30], BYTES)
    }

    /// Makes libtorch free what it has cached, which it does not do during a recording.
    fn free_cached() {
        assert!(room(1 << 20).is_err(), "in vain, but libtorch has freed what it had cached");
    }

    /// GiB of which there is room for no second tensor. Nothing is cached afterwards.
    fn most_room() -> i64 {
        let most = (0..10).rev().map(|power| 1 << power).find(|&gib| room(gib).is_ok()).unwrap();
        free_cached();
        most
    }

    /// Records a graph that writes ones, and launches it.
    fn ones(recorder: &Recorder) -> (Graph, Tensor) {
        let (graph, mut ones) = recorder.record(0, || Ok(Tensor::ones([2], BYTES))).unwrap();
        replay(&graph, &mut ones);
        (graph, ones)
    }

    fn replay(graph: &Graph, ones: &mut Tensor) {
        let _ = ones.zero_();
        graph.replay().unwrap();
        assert_eq!(Vec::<u8>::try_from(&*ones).unwrap(), [1, 1]);
    }

    /// libtorch's allocator frees memory, its generator draws random numbers, and this recorder and others record.
    fn all_goes_on(recorder: &Recorder, memory: Memory, most: i64) {
        let again = room(most);
        assert!(again.is_ok(), "{most} GiB: {again:?}");
        let random = Tensor::f_rand([2], (Kind::Float, Device::Cuda(0)));
        assert!(random.is_ok(), "{random:?}");
        for recorder in [&Recorder::open(Priority::Low, memory).unwrap(), recorder, recorder] {
            // Each time none of its graphs is left.
            drop(ones(recorder));
        }
    }

    #[test]
    #[ignore = "needs a CUDA device"]
    fn a_recording_that_failed_gives_its_memory_back() {
        let _alone = crate::device::cuda_alone();
        let most = most_room();
        for memory in [Memory::Apart, Memory::Shared] {
            for earlier_graph in [false, true] {
                free_cached();
                let recorder = Recorder::open(Priority::Low, memory).unwrap();
                let mut earlier = earlier_graph.then(|| ones(&recorder));

                let void = recorder.record(0, || {
                    drop(room(most)?);
                    recorder.wait()
                });
                let refused =
                    |error: &CudaError| matches!(error, CudaError::Driver { call: "cuStreamSynchronize", .. });
                assert!(matches!(&void, Err(GraphError::Cuda(error)) if refused(error)), "the first error: {void:?}");

                free_cached();
                // Only the end of the recording tells, and what was computed in it is still held then.
                let void = recorder.record(0, || {
                    let tensor = room(most)?;
                    let _ = recorder.wait();
                    Ok(tensor)
                });
                assert!(matches!(void, Err(GraphError::Torch(_))), "{void:?}");

                if let Some((graph, ones)) = &mut earlier {
                    replay(graph, ones);
                }
                drop(earlier);
                all_goes_on(&recorder, memory, most);
            }
        }
    }

    /// A good graph stands for one that libtorch has ended and the driver has no room to instantiate.
    #[test]
    #[ignore = "needs a CUDA device"]
    fn a_recording_that_was_ended_and_given_up_gives_its_memory_back() {
        let _alone = crate::device::cuda_alone();
        let most = most_room();
        for memory in [Memory::Apart, Memory::Shared] {
            free_cached();
            let recorder = Recorder::open(Priority::Low, memory).unwrap();
            let written = recorder.record(0, || {
                let _ = room(most)?.narrow(0, 0, 1).zero_();
                Ok(())
            });
            let (graph, ()) = written.unwrap();
            assert!(graph.is_ended());
            assert!(room(most).is_err(), "the graph has the memory");
            recorder.give_up(ManuallyDrop::new(graph));
            all_goes_on(&recorder, memory, most);
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
