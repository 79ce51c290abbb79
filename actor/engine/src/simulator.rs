//! What an actor process runs.

use proto::episode::EnvironmentId;
use proto::record::{End, RecordHeader};
use std::error::Error;
use wire::message::Snapshot;

/// Environments of a task, numbered from 0, each in one episode at a time. The same episode and actions give the same bits
/// in every process. Where every method is implemented, whatever it simulates can take part in a run.
pub trait Simulator {
    type Error: Into<Box<dyn Error + Send + Sync>>;

    /// What an environment is called in its episode of this number.
    fn place(&self, home: EnvironmentId, _episode: u32) -> EnvironmentId {
        home
    }

    /// Environments are about to begin episodes in these places, in this order: what takes long may be done ahead.
    fn announce(&self, _places: impl DoubleEndedIterator<Item = EnvironmentId>) {}

    /// Puts environment number `index` at the start of an episode; the first time it makes the environment. Returns the
    /// state's hash. `ahead` is the record that it is observed in next, where it lies ready, and else empty: images may be
    /// written there at once.
    fn begin(&mut self, index: usize, home: EnvironmentId, episode: u32, ahead: &mut [u8]) -> Result<u64, Self::Error>;

    /// Puts environment number `index` where it was after `step` actions of an episode, by what it wrote into a record's
    /// snapshot there ([`proto::task::Layout::snapshot`]) and the state's hash. At least one action follows before it is
    /// seen. A task without snapshots is never asked.
    fn restore(
        &mut self,
        index: usize,
        home: EnvironmentId,
        episode: u32,
        step: u32,
        snapshot: &Snapshot,
    ) -> Result<(), Self::Error>;

    /// Environments from number `first` on are about to take these actions, each of which the task has or is
    /// HOLD: whatever steps several at once does it now, and [`Self::act`] reports what came of each.
    fn act_together(&mut self, _first: usize, _actions: &[u8]) -> Result<(), Self::Error> {
        Ok(())
    }

    /// Takes one action, which the task has, and writes what it did: the bytes of a record's parts and outcomes. It does
    /// not begin the next episode. Returns the state's hash, and how the episode has ended, if it has. `ahead` as of
    /// [`Self::begin`].
    fn act(
        &mut self,
        index: usize,
        action: &[u8],
        done: &mut [u8],
        ahead: &mut [u8],
    ) -> Result<(u64, Option<End>), Self::Error>;

    /// Writes what is seen now: observations and states with the gaps between them, images with their bits in the header,
    /// and the snapshot of a task that is restored by such. All other small bytes of the record are written already.
    fn observe(&mut self, index: usize, header: &mut RecordHeader, record: &mut [u8]) -> Result<(), Self::Error>;

    /// Prepares the start of an episode that may come next, by a piece of work of about a quarter of a millisecond.
    /// Returns whether there is more to do. The episode is the same without it.
    fn prepare(&mut self, _index: usize, _home: EnvironmentId, _episode: u32) -> bool {
        false
    }
}
