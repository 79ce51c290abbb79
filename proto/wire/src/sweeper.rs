//! Sweeping what dead processes left in iceoryx2, on a thread of its own: another program's hand in those files can
//! keep a sweep busy for minutes, and the orchestrator must go on to supervise meanwhile.

use iceoryx2::config::Config;
use iceoryx2::prelude::{CallbackProgression, Node, NodeState, ipc};
use std::cell::Cell;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TryRecvError, sync_channel};
use std::time::Duration;

/// After this long its caller goes on without a sweep: a second, and this for each process. A dead one takes 3 ms.
const PATIENCE_EACH: Duration = Duration::from_millis(10);

#[derive(Debug)]
pub struct Sweeper {
    requests: SyncSender<()>,
    done: Receiver<()>,
    /// A sweep was asked for and has not ended.
    busy: Cell<bool>,
    patience: Duration,
}

impl Sweeper {
    pub fn of(config: Config, processes: u32) -> std::io::Result<Self> {
        Self::with_patience(move || sweep_nodes(&config), Duration::from_secs(1) + PATIENCE_EACH * processes)
    }

    fn with_patience(mut sweep: impl FnMut() + Send + 'static, patience: Duration) -> std::io::Result<Self> {
        let (requests, asked) = sync_channel::<()>(1);
        let (report, done) = sync_channel::<()>(1);
        // It ends when the sweeper is dropped; one that hangs in a sweep ends with the process.
        std::thread::Builder::new().name("sweeper".to_owned()).spawn(move || {
            while asked.recv().is_ok() {
                sweep();
                if report.send(()).is_err() {
                    break;
                }
            }
        })?;
        Ok(Self { requests, done, busy: Cell::new(false), patience })
    }

    /// Sweeps, and waits until that is done; false if it takes too long. As long as a sweep goes on, later calls return
    /// false at once.
    pub fn sweep(&self) -> bool {
        if self.busy.get() {
            match self.done.try_recv() {
                Ok(()) => tracing::info!("the sweep of dead processes has ended"),
                Err(TryRecvError::Empty | TryRecvError::Disconnected) => return false,
            }
        }
        // The queue has room: nothing is under way.
        if self.requests.send(()).is_err() {
            return false;
        }
        match self.done.recv_timeout(self.patience) {
            Ok(()) => {
                self.busy.set(false);
                true
            }
            Err(RecvTimeoutError::Disconnected) => {
                self.busy.set(true);
                tracing::error!("the thread that sweeps dead processes has ended: nothing is swept any more");
                false
            }
            Err(RecvTimeoutError::Timeout) => {
                self.busy.set(true);
                tracing::warn!(
                    "the sweep of dead processes takes longer than {:.1} s; the run goes on without it: this \
                     machine is very busy, or another program has changed the run's files in /dev/shm",
                    self.patience.as_secs_f64()
                );
                false
            }
        }
    }
}

/// What [`Node::try_cleanup_dead_nodes`] does, on any thread: a node itself stays on the one that made it.
fn sweep_nodes(config: &Config) {
    let listed = Node::<ipc::Service>::list(config, |state| {
        if let NodeState::Dead(dead) = state
            && let Err(cause) = dead.try_remove_stale_resources()
        {
            tracing::debug!("what a dead process left cannot be removed now: {cause:?}");
        }
        CallbackProgression::Continue
    });
    if let Err(cause) = listed {
        tracing::debug!("the dead processes cannot be listed: {cause:?}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicU32, Ordering};
    use std::sync::mpsc::channel;
    use std::time::Instant;

    #[test]
    fn a_sweep_that_hangs_holds_its_caller_once_and_not_for_long() {
        let (go_on, wait) = channel::<()>();
        let count = Arc::new(AtomicU32::new(0));
        let counted = Arc::clone(&count);
        let sweep = move || {
            // The second one hangs.
            if counted.fetch_add(1, Ordering::SeqCst) == 1 {
                wait.recv().unwrap();
            }
        };
        let sweeper = Sweeper::with_patience(sweep, Duration::from_millis(200)).unwrap();
        assert!(sweeper.sweep());
        let began = Instant::now();
        assert!(!sweeper.sweep());
        assert!(began.elapsed() >= Duration::from_millis(200));
        // Many calls that each waited would take 20 s.
        assert!((0..100).all(|_| !sweeper.sweep()));
        assert!(began.elapsed() < Duration::from_secs(10));
        assert_eq!(count.load(Ordering::SeqCst), 2);
        go_on.send(()).unwrap();
        let deadline = Instant::now() + Duration::from_secs(10);
        while !sweeper.sweep() {
            assert!(Instant::now() < deadline, "it sweeps again once the sweep that hung has ended");
            std::thread::sleep(Duration::from_millis(5));
        }
        assert_eq!(count.load(Ordering::SeqCst), 3);
    }
}
