//! The recorder: reads the samples that pass between actors and learner where they lie in shared memory, and writes
//! MCAP.
//!
//! It is one thread with its own subscriber ([`tap`]). What is news is decided by a pure [`ledger`]; what is said about
//! it, by the [`scribe`]; how it reaches the disk, by [`segment`]. Actors block until the recorder has taken a
//! sample, so whatever happens to the disk, the thread goes on taking samples: after a failed write it only stops
//! writing, and [`Recorder::failure`] says why. A segment is a complete file at every moment ([`live`], [`index`]).

mod camera;
mod handle;
mod index;
mod ledger;
mod live;
mod note;
mod scribe;
pub mod segment;
mod tap;
#[cfg(test)]
pub mod testing;
#[cfg(test)]
mod tests;

pub use handle::Recorder;
pub use note::RecorderSetup;
