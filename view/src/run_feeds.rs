//! One reader of a run, however many watch it: a task for each run that is watched, which ends with its last watcher.

use crate::answer::text_of;
use crate::data::Runs;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::watch;

const EVERY: Duration = Duration::from_secs(1);
/// A reading that takes long is followed by a pause of so many times its length: watching never takes more than a
/// share of a core.
const REST: u32 = 4;

#[derive(Clone)]
pub struct RunFeeds {
    runs: Arc<dyn Runs>,
    watched: Arc<Mutex<HashMap<String, watch::Sender<Arc<str>>>>>,
}

impl RunFeeds {
    pub fn new(runs: Arc<dyn Runs>) -> Self {
        Self { runs, watched: Arc::default() }
    }

    /// Follows a run: JSON of how it stands, whenever that changes. The first value may be empty.
    pub fn follow(&self, run: &str) -> watch::Receiver<Arc<str>> {
        let mut watched = self.watched.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(sender) = watched.get(run) {
            return sender.subscribe();
        }
        let (sender, receiver) = watch::channel(Arc::from(""));
        watched.insert(run.to_owned(), sender.clone());
        tokio::spawn(self.clone().watch(run.to_owned(), sender));
        receiver
    }

    async fn watch(self, run: String, sender: watch::Sender<Arc<str>>) {
        loop {
            let began = tokio::time::Instant::now();
            let (runs, name) = (Arc::clone(&self.runs), run.clone());
            let read = tokio::task::spawn_blocking(move || text_of(&runs.live(&name))).await;
            let took = began.elapsed();
            let Ok(text) = read else { break };
            sender.send_if_modified(|last| {
                let changed = **last != *text;
                if changed {
                    *last = Arc::from(text);
                }
                changed
            });
            tokio::time::sleep(EVERY.max(took * REST)).await;
            let mut watched = self.watched.lock().unwrap_or_else(PoisonError::into_inner);
            // Under the lock: nobody can begin to watch in between.
            if sender.receiver_count() == 0 {
                watched.remove(&run);
                return;
            }
        }
        self.watched.lock().unwrap_or_else(PoisonError::into_inner).remove(&run);
    }
}
