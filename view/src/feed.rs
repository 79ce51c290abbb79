//! What is new of a run, message by message, for programs that draw it themselves.

use proto::show::{ShownEpisode, ShownSolids};
use std::sync::Arc;

#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Topic {
    pub name: String,
    pub encoding: String,
    /// What a message is called.
    pub schema_name: String,
    pub schema_encoding: String,
    pub schema: Vec<u8>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recorded {
    pub topic: Arc<Topic>,
    /// When it was recorded, nanoseconds since 1970.
    pub at_ns: u64,
    pub data: Vec<u8>,
}

/// A run as messages. Reading may take a tenth of a second.
pub trait Feed: Send + Sync {
    /// What was recorded since this was called last; the first time the newest message of each topic.
    fn read(&mut self) -> Vec<Recorded>;
    /// All topics of recordings that are known.
    fn topics(&self) -> Vec<Arc<Topic>>;
    /// The topics of [`Feed::moment`].
    fn moment_topics(&self) -> Vec<Arc<Topic>>;
    /// An episode's newest moment; `whole`: what was shown before is void.
    fn moment(&self, shown: &ShownEpisode, solids: &ShownSolids, whole: bool) -> Vec<Recorded>;
}
