use proto::show::{ShownEpisode, ShownSolids};
use std::sync::Arc;

#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Topic {
    pub name: String,
    pub encoding: String,
    pub schema_name: String,
    pub schema_encoding: String,
    pub schema: Vec<u8>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recorded {
    pub topic: Arc<Topic>,
    pub at_ns: u64,
    pub data: Vec<u8>,
}

pub trait Feed: Send + Sync {
    /// What was recorded since this was called last; the first time the newest message of each topic.
    fn read(&mut self) -> Vec<Recorded>;
    fn topics(&self) -> Vec<Arc<Topic>>;
    fn moment_topics(&self) -> Vec<Arc<Topic>>;
    fn moment(&self, shown: &ShownEpisode, solids: &ShownSolids, whole: bool) -> Vec<Recorded>;
}
