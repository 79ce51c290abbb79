//! The recorder: reads the samples that pass between actors and learner where they lie in shared memory, and writes
//! MCAP.
//!
//! It is one thread with its own subscriber. Actors block until the recorder has taken a sample, so whatever happens to
//! the disk, the thread goes on taking samples: after a failed write it only stops writing, and [`Recorder::failure`] says
//! why.

pub mod camera;
mod channels;
mod handle;
mod held_back;
mod index;
mod ledger;
mod live;
mod message_writer;
mod note;
mod recorder_thread;
pub mod segment;
mod tally;
#[cfg(test)]
pub mod testing;
#[cfg(test)]
mod tests;

pub use handle::Recorder;
pub use ledger::{Ledger, Verdict};
pub use note::RecorderSetup;
pub use tally::{Gap, Tally};
