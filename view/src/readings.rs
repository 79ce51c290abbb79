//! Readings of runs: on threads where waiting for a disk is no harm, few at a time, and not endlessly many wait.

use crate::answer::Refusal;
use crate::data::{Problem, Runs};
use axum::http::StatusCode;
use std::sync::Arc;
use tokio::sync::Semaphore;

/// Readings of runs at a time. Those of one run go one after the other, and each answers in seconds.
const READERS: usize = 8;
const WAITING: usize = 256;

#[derive(Clone)]
pub struct Readings {
    runs: Arc<dyn Runs>,
    readers: Arc<Semaphore>,
    queue: Arc<Semaphore>,
}

impl Readings {
    pub fn of(runs: Arc<dyn Runs>) -> Self {
        Self { runs, readers: Arc::new(Semaphore::new(READERS)), queue: Arc::new(Semaphore::new(WAITING)) }
    }

    pub async fn read<T, F>(&self, ask: F) -> Result<T, Refusal>
    where
        T: Send + 'static,
        F: FnOnce(&dyn Runs) -> Result<T, Problem> + Send + 'static,
    {
        let busy = || Refusal(StatusCode::SERVICE_UNAVAILABLE, "too many requests wait: try again".to_owned());
        let _queued = Arc::clone(&self.queue).try_acquire_owned().map_err(|_| busy())?;
        let reader = Arc::clone(&self.readers).acquire_owned().await.map_err(|_| busy())?;
        let runs = Arc::clone(&self.runs);
        let read = tokio::task::spawn_blocking(move || {
            // Held by the reading itself: one who hangs up does not make room for another.
            let _reader = reader;
            ask(&*runs)
        });
        let failed = || {
            Refusal(StatusCode::INTERNAL_SERVER_ERROR, "reading the run failed: see the viewer's terminal".to_owned())
        };
        Ok(read.await.map_err(|_| failed())??)
    }
}
