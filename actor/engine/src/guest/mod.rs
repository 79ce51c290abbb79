//! Environments whose code is not ours, in whichever language: what an actor's process of such does.
//!
//! ```text
//! record   where they write what they show
//! served   such environments, as the engine runs them: seeds, states' hashes, checks
//! process  the process's part in a run
//! notes    what it keeps written down for those who find it dead, or grown
//! replay   recorded episodes, simulated again
//! ```

mod notes;
mod process;
mod record;
mod replay;
mod served;

pub use process::{GuestActor, GuestError};
pub use record::{Record, Source};
pub use replay::{Replay, ReplayError};
pub use served::{Failure, Served};

/// Environments of a run, numbered from 0. What is wrong with one is a sentence without its place.
pub trait Guest {
    /// Begins the episode of a seed in environment number `index`, and writes what is seen into its record.
    fn reset(&mut self, index: usize, seed: u32, record: Record<'_>) -> Result<(), String>;

    /// Takes an action, and writes its reward, its parts and outcomes, and what is seen. Returns whether it ended the
    /// episode: terminated, truncated.
    fn step(&mut self, index: usize, action: &[u8], record: Record<'_>) -> Result<[bool; 2], String>;

    /// Whether [`Self::show_again`] does so. Then images are written straight into shared memory, and no copy is kept.
    fn shows_again(&self) -> bool {
        false
    }

    /// Writes the images that `reset` or `step` wrote last for an environment.
    fn show_again(&mut self, _index: usize, _record: Record<'_>) -> Result<(), String> {
        Err("it does not show its images again".to_owned())
    }

    /// The actions that environments from number `first` on are about to take; HOLD is none.
    fn step_together(&mut self, _first: usize, _actions: &[u8]) -> Result<(), String> {
        Ok(())
    }

    /// What brings an environment back to where it is now, of a task that is restored by snapshots.
    fn snapshot(&mut self, _index: usize) -> Result<Vec<u8>, String> {
        Err("it gives no snapshots, which its task declares".to_owned())
    }

    fn restore(&mut self, _index: usize, _snapshot: &[u8]) -> Result<(), String> {
        Err("it takes no snapshots, which its task declares".to_owned())
    }
}
