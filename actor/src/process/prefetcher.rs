//! Kitchens for environments that go from one to another: made and opened ahead, while the actor waits for its learner.
//!
//! What takes long about a procedural kitchen, a second of search, is done once and kept in the run folder, for all
//! actors and all later starts ([`simulator::source`]). To open one takes milliseconds, and all actors would wait for
//! the one that does. So a thread of low priority does both before they are needed: it makes the kitchen that each
//! environment goes to next, and opens it when that is near. Whether it was made and opened ahead, just now, or by
//! another process does not matter to a single bit.
//!
//! An environment has at most one kitchen that waits for it. Environments that are in one kitchen share it.

use anyhow::Result;
use proto::config::Config;
use proto::kitchen::KitchenId;
use simulator::depth::Scenery;
use simulator::kitchen::Kitchen;
use simulator::source;
use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError, Weak};

pub struct KitchenPrefetcher {
    config: Config,
    folder: PathBuf,
    orders: Arc<Orders>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Order {
    /// The environment that goes there, by its number in the run.
    pub environment: u32,
    pub kitchen: KitchenId,
    pub open: bool,
}

#[derive(Debug)]
pub struct Opened {
    pub kitchen: Arc<Kitchen>,
    /// What a camera shows of it, if that was made ahead.
    pub scenery: Option<Scenery>,
}

/// What the thread and its actor share. Either holds the lock for moments only.
#[derive(Default)]
struct Orders {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    /// At most one an environment.
    waiting: VecDeque<Order>,
    /// What the thread does; none if nobody wants it any more.
    at_work: Option<Order>,
    /// By environment.
    ready: BTreeMap<u32, Opened>,
    /// Kitchens that somebody is in, or that wait.
    in_use: BTreeMap<KitchenId, Weak<Kitchen>>,
    /// Nobody orders any more.
    closed: bool,
}

impl KitchenPrefetcher {
    /// The kitchens of the run in this folder. The thread that is ahead is started if environments move.
    pub fn of(config: &Config, folder: &Path) -> Result<Self> {
        let prefetcher = Self::without_thread(config, folder);
        if config.kitchen_schedule().moves() {
            let (config, folder, orders) =
                (prefetcher.config.clone(), prefetcher.folder.clone(), Arc::clone(&prefetcher.orders));
            std::thread::Builder::new().name("prefetcher".to_owned()).spawn(move || orders.work(&config, &folder))?;
        }
        Ok(prefetcher)
    }

    /// The same kitchens, each made and opened when it is taken.
    pub(crate) fn without_thread(config: &Config, folder: &Path) -> Self {
        Self { config: config.clone(), folder: folder.to_path_buf(), orders: Arc::default() }
    }

    /// Has a kitchen made ahead, if it is not there yet, or opened ahead. It takes the place of what the environment
    /// ordered before.
    pub fn order(&self, order: Order) {
        let mut state = self.orders.lock();
        let ready = state.ready.get(&order.environment).is_some_and(|opened| opened.kitchen.id() == order.kitchen);
        if ready || state.at_work == Some(order) || state.waiting.contains(&order) {
            return;
        }
        let unwanted = state.cancel(order.environment);
        state.waiting.push_back(order);
        drop(state);
        self.orders.changed.notify_all();
        drop(unwanted);
    }

    /// The kitchen, opened; made first if that was not done ahead. If the thread is just making or opening it, this does
    /// not wait: on a busy machine a thread of low priority may get no processor for minutes.
    pub fn take(&self, environment: u32, kitchen: KitchenId) -> Result<Opened> {
        let mut state = self.orders.lock();
        let ready = state.cancel(environment);
        let shared = state.shared(kitchen);
        drop(state);
        if let Some(opened) = ready.filter(|opened| opened.kitchen.id() == kitchen) {
            return Ok(opened);
        }
        let kitchen = match shared {
            Some(kitchen) => kitchen,
            None => self.orders.open(kitchen, &self.config, &self.folder)?,
        };
        Ok(Opened { kitchen, scenery: None })
    }
}

impl Drop for KitchenPrefetcher {
    fn drop(&mut self) {
        self.orders.lock().closed = true;
        self.orders.changed.notify_all();
    }
}

impl State {
    /// Forgets what an environment has ordered. What was opened for it is to be dropped when the lock is no longer held:
    /// that takes a while.
    fn cancel(&mut self, environment: u32) -> Option<Opened> {
        self.waiting.retain(|order| order.environment != environment);
        self.at_work = self.at_work.filter(|order| order.environment != environment);
        self.ready.remove(&environment)
    }

    fn shared(&self, kitchen: KitchenId) -> Option<Arc<Kitchen>> {
        self.in_use.get(&kitchen).and_then(Weak::upgrade)
    }

    /// The next thing to do: a kitchen that is needed open is needed sooner.
    fn next(&mut self) -> Option<Order> {
        let soon = self.waiting.iter().position(|order| order.open).unwrap_or(0);
        self.at_work = self.waiting.remove(soon);
        self.at_work
    }
}

impl Orders {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Opens a kitchen that nobody is in.
    fn open(&self, kitchen: KitchenId, config: &Config, folder: &Path) -> Result<Arc<Kitchen>> {
        let opened = Arc::new(source::of_run_and_kept(kitchen, config, folder)?);
        let mut state = self.lock();
        state.in_use.retain(|_, kitchen| kitchen.strong_count() > 0);
        state.in_use.insert(kitchen, Arc::downgrade(&opened));
        Ok(opened)
    }

    /// Does what is ordered, one after the other, until nobody orders any more.
    fn work(&self, config: &Config, folder: &Path) {
        // Linux keeps a priority for each thread: this one has what the others leave.
        if let Err(error) = rustix::process::nice(10) {
            tracing::debug!("kitchens are made ahead at full priority: {error}");
        }
        while let Some(order) = self.wait_for_order() {
            if let Err(error) = self.carry_out(order, config, folder) {
                // Whoever takes it meets the same error, and can end the actor with it.
                tracing::debug!("kitchen {} cannot be made ahead: {error}", order.kitchen);
            }
        }
    }

    fn wait_for_order(&self) -> Option<Order> {
        let mut state = self.lock();
        state.at_work = None;
        loop {
            if state.closed {
                return None;
            }
            if let Some(order) = state.next() {
                return Some(order);
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn carry_out(&self, order: Order, config: &Config, folder: &Path) -> Result<()> {
        if !order.open {
            source::keep_ready(order.kitchen, config, folder)?;
            return Ok(());
        }
        let shared = self.lock().shared(order.kitchen);
        let kitchen = match shared {
            Some(kitchen) => kitchen,
            None => self.open(order.kitchen, config, folder)?,
        };
        let opened = Opened { scenery: Some(Scenery::of(kitchen.bodies())), kitchen };
        let mut state = self.lock();
        // Otherwise the environment was here before, or goes elsewhere, and the kitchen is dropped after the lock.
        if state.at_work == Some(order) {
            state.ready.insert(order.environment, opened);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
