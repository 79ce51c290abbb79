//! Kitchens for environments that go from one to another: made ahead, while the actor waits for its learner.
//!
//! What takes long about a procedural kitchen, a second of search, is done once and kept in the run folder, for all
//! actors and all later starts ([`simulator::source`]). A thread of low priority makes those that will be needed next;
//! opening one takes milliseconds. Whether it was made ahead, just now, or by another process does not matter to a
//! single bit.

use anyhow::Result;
use proto::config::Config;
use proto::kitchen::KitchenId;
use simulator::kitchen::Kitchen;
use simulator::source;
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, PoisonError};

/// The kitchens of a run.
pub struct Larder {
    config: Config,
    /// The run folder.
    folder: PathBuf,
    orders: Arc<Orders>,
}

/// What the thread is to make.
#[derive(Default)]
struct Orders {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    waiting: VecDeque<KitchenId>,
    at_work: Option<KitchenId>,
    /// Nobody orders any more.
    closed: bool,
}

impl Larder {
    /// The kitchens of the run in this folder. The thread that makes them ahead is started if environments move.
    pub fn of(config: &Config, folder: &Path) -> Result<Self> {
        let orders = Arc::new(Orders::default());
        let larder = Self { config: config.clone(), folder: folder.to_path_buf(), orders };
        if config.rota().moves() {
            let (config, folder, orders) = (larder.config.clone(), larder.folder.clone(), Arc::clone(&larder.orders));
            std::thread::Builder::new().name("larder".to_owned()).spawn(move || orders.work(&config, &folder))?;
        }
        Ok(larder)
    }

    /// Has a kitchen made ahead, if it is not there yet.
    pub fn order(&self, kitchen: KitchenId) {
        let mut state = self.orders.lock();
        if state.at_work != Some(kitchen) && !state.waiting.contains(&kitchen) {
            state.waiting.push_back(kitchen);
            self.orders.changed.notify_all();
        }
    }

    /// The kitchen, opened; made first if that was not done ahead. If the thread is just making it, this does not wait: on
    /// a busy machine a thread of low priority may get no processor for minutes.
    pub fn take(&self, kitchen: KitchenId) -> Result<Kitchen> {
        self.orders.lock().waiting.retain(|waiting| *waiting != kitchen);
        Ok(source::of_run_and_kept(kitchen, &self.config, &self.folder)?)
    }
}

impl Drop for Larder {
    fn drop(&mut self) {
        self.orders.lock().closed = true;
        self.orders.changed.notify_all();
    }
}

impl Orders {
    fn lock(&self) -> std::sync::MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Makes what is ordered, one after the other, until nobody orders any more.
    fn work(&self, config: &Config, folder: &Path) {
        // Linux keeps a priority for each thread: this one has what the others leave.
        if let Err(error) = rustix::process::nice(10) {
            tracing::debug!("kitchens are made ahead at full priority: {error}");
        }
        loop {
            let mut state = self.lock();
            let kitchen = loop {
                if state.closed {
                    return;
                }
                if let Some(kitchen) = state.waiting.pop_front() {
                    break kitchen;
                }
                state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
            };
            state.at_work = Some(kitchen);
            drop(state);
            if let Err(error) = source::keep_ready(kitchen, config, folder) {
                // Whoever takes it meets the same error, and can end the actor with it.
                tracing::debug!("kitchen {kitchen} cannot be made ahead: {error}");
            }
            self.lock().at_work = None;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::config::KitchenSource;
    use proto::run_folder::RunFolder;
    use std::time::{Duration, Instant};

    #[test]
    fn what_is_ordered_is_made_ahead_and_is_the_same_as_what_is_taken_at_once() {
        let [ahead, at_once] = [(); 2].map(|()| tempfile::tempdir().unwrap());
        let mut config = Config::default();
        config.kitchens.source = KitchenSource::Procedural;
        let id = KitchenId::new(1002).unwrap();
        let file = |folder: &Path| RunFolder::new(folder).kitchens().join("1002.kitchen");
        let larder = Larder::of(&config, ahead.path()).unwrap();
        larder.order(id);
        larder.order(id);
        let begun = Instant::now();
        while !file(ahead.path()).exists() {
            assert!(begun.elapsed() < Duration::from_mins(2), "nobody makes it");
            std::thread::sleep(Duration::from_millis(20));
        }
        let made_ahead = larder.take(id).unwrap();
        let taken = Larder::of(&config, at_once.path()).unwrap().take(id).unwrap();
        assert_eq!(made_ahead.settled_poses(), taken.settled_poses());
        assert_eq!(std::fs::read(file(ahead.path())).unwrap(), std::fs::read(file(at_once.path())).unwrap());
    }
}
