//! `ppo.overlap`: the next rollout is collected while the update of the last one runs, on a thread of its own.
//!
//! ```text
//! acting     rollout 0 with W0 │ rollout 1 with W0 │ rollout 2 with W1 │ rollout 3 with W2 …
//! updating                     │ 0: W0 → W1        │ 1: W1 → W2        │ 2: W2 → W3 …
//! ```
//! Both are joined at every boundary. So a rollout is always collected with the weights from before the last update,
//! whatever the timing, and a run is still a function of its seed.
//!
//! The weights that act are a copy, renewed in its place, because recorded graphs know the addresses. For the same
//! reason frames are copied out of the store that acting writes to. On a GPU both threads have a stream of their own,
//! that of acting with the higher priority: a step of the policy is short, and many processes wait for it.
//!
//! libtorch gives freed memory out again on the stream that it was made on, without asking whether another one still
//! uses it. That is safe here. Whoever hands something over first waits for its own stream, and what one thread has made
//! the other frees only when nothing runs that uses it: an update borrows its rollout, which is dropped by the thread
//! that acts.
//!
//! Both threads record graphs. That of acting is recorded at the first step of a size, which today is in the first
//! rollout, beside which no update runs; those of training are recorded in an update, beside which acting goes on. A
//! recording is of its own thread and stream. It bears whatever the other thread does but a wait for the whole device,
//! and so another recording, which has one: `ffi/graph.rs` lets one thread at a time do either.

use super::error::AgentError;
use super::trainer::{Done, HERE, Job, Trainer, build};
use crate::device::log_warnings;
use crate::ffi::graph::wait_for_device;
use crate::ffi::stream::{Priority, StreamError, Streams};
use crate::network::{Kept, Network};
use proto::config::Config;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use tch::{Device, Kind, Tensor};

#[derive(Debug)]
pub(super) struct Overlap {
    /// The network that acts.
    pub policy: Network,
    /// Room for what is trained on, while no update has it.
    pub store: Option<Kept>,
    /// Of a GPU.
    streams: Option<Streams>,
    /// Closed to end the thread.
    jobs: Option<Sender<Job>>,
    done: Receiver<Done>,
    thread: Option<JoinHandle<()>>,
    busy: bool,
}

impl Overlap {
    /// Starts the thread. On a GPU the calling thread, which is to act, gets a stream of its own.
    pub fn start(config: &Config, device: Device) -> Result<Self, AgentError> {
        let (policy, _) = build(config, device)?;
        let (streams, stream) = if device.is_cuda() {
            wait_for_device(0);
            let streams = Streams::open().map_err(StreamError::from)?;
            let make = |priority| streams.make(priority).map_err(StreamError::from);
            make(Priority::High)?.take()?;
            (Some(streams), Some(make(Priority::Low)?))
        } else {
            (None, None)
        };
        // Settings of each thread: this, and who hears libtorch's warnings.
        let threads = tch::get_num_threads();
        let (jobs, due) = channel::<Job>();
        let (made, done) = channel();
        let run = move || {
            tch::set_num_threads(threads);
            log_warnings();
            if let Some(stream) = stream {
                // The first operation makes the device's context this thread's.
                let _ = Tensor::zeros([1], (Kind::Float, device));
                stream.take().expect("libtorch has taken such a stream on another thread");
            }
            for job in due {
                let finished = job.run();
                await_stream(streams);
                if made.send(finished).is_err() {
                    return;
                }
            }
        };
        let thread = std::thread::Builder::new().name("update".into()).spawn(run).map_err(AgentError::Thread)?;
        Ok(Self { policy, store: None, streams, jobs: Some(jobs), done, thread: Some(thread), busy: false })
    }

    /// Has the network that acts take these weights.
    pub fn publish(&self, network: &Network) {
        tch::no_grad(|| self.policy.parameters.flat().copy_(&network.parameters.flat()));
    }

    /// Begins an update. Acting goes on with the weights from before it. Returns the store that acting has written to.
    pub fn begin(&mut self, mut job: Job) -> Kept {
        self.publish(&job.trainer.network);
        let used = job.collected.kept();
        let fits = |store: &Kept| store.parts(used).into_iter().all(|(store, used)| store.size() == used.size());
        let store = self.store.take().filter(fits).unwrap_or_else(|| used.map(Tensor::empty_like));
        let free = job.collected.move_to(store);
        await_stream(self.streams);
        self.busy = true;
        let jobs = self.jobs.as_ref().expect("it is closed when this is dropped");
        jobs.send(job).expect("the thread lives until then");
        free
    }

    pub fn is_busy(&self) -> bool {
        self.busy
    }

    pub fn finish(&mut self) -> Done {
        assert!(std::mem::take(&mut self.busy), "an update was begun");
        self.done.recv().expect("the thread of the update has panicked")
    }
}

impl Drop for Overlap {
    fn drop(&mut self) {
        self.jobs = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Waits for all that this thread has given its stream. The other thread's stream would not.
fn await_stream(streams: Option<Streams>) {
    if let Some(streams) = streams {
        streams.wait().expect("a device that fails ends the process");
    }
}

pub(super) fn policy<'a>(overlap: Option<&'a Overlap>, trainer: Option<&'a Trainer>) -> &'a Network {
    overlap.map_or_else(|| &trainer.expect(HERE).network, |overlap| &overlap.policy)
}
