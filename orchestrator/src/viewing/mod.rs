//! What `orchestrator view` shows of runs: [`view::data::Runs`] from their folders alone.
//!
//! [`roster`] finds runs and gives them names for addresses; of each run that is looked at, [`watched`] keeps what was
//! read, and reads only what is new ([`tail`], and the recordings' shelf); [`logbook`] finds the logs of a run.
//! [`processes`] looks at the processes of a run on this machine and at GPUs, [`table`] filters and sorts episodes.
//! [`live`] hands a run on message by message.

mod live;
pub mod logbook;
mod processes;
mod roster;
mod table;
mod tail;
mod watched;

use proto::replay::{RecordedEpisode, ReplaySetup};
use roster::{Entry, Roster};
use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use view::data::{Card, Curves, EpisodeKey, EpisodePage, EpisodeQuery, Live, Problem, Runs};
use view::feed::Feed;
use watched::Watched;

/// The list is made anew at most this often.
const LIST_EVERY: Duration = Duration::from_secs(2);

/// Runs in folders.
pub struct Gallery {
    roster: Mutex<Roster>,
    watched: Mutex<HashMap<String, Arc<Mutex<Watched>>>>,
    list: Mutex<Option<(Instant, Vec<Card>)>>,
}

impl Gallery {
    /// Of these run folders, or folders that hold runs.
    pub fn of(paths: Vec<PathBuf>) -> Self {
        Self { roster: Mutex::new(Roster::of(paths)), watched: Mutex::default(), list: Mutex::default() }
    }

    /// How many runs there are now.
    pub fn count(&self) -> usize {
        self.entries().len()
    }

    /// Names of those of these folders that are runs, in their order.
    pub fn names_of(&self, folders: &[PathBuf]) -> Vec<String> {
        let entries = self.entries();
        let name =
            |folder: &PathBuf| entries.iter().find(|entry| entry.folder == *folder).map(|entry| entry.id.clone());
        folders.iter().filter_map(name).collect()
    }

    fn entries(&self) -> Vec<Entry> {
        self.roster.lock().unwrap_or_else(PoisonError::into_inner).look()
    }

    fn watched(&self, run: &str) -> Result<Arc<Mutex<Watched>>, Problem> {
        let mut watched = self.watched.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = watched.get(run).filter(|known| known.try_lock().map_or(true, |known| known.is_there())) {
            return Ok(Arc::clone(known));
        }
        let found = self.entries().into_iter().find(|entry| entry.id == run);
        let Some(entry) = found else {
            watched.remove(run);
            return Err(Problem::NotThere(format!("there is no run called {run}")));
        };
        let new = Arc::new(Mutex::new(Watched::of(entry)));
        watched.insert(run.to_owned(), Arc::clone(&new));
        Ok(new)
    }

    fn with<T>(&self, run: &str, ask: impl FnOnce(&mut Watched) -> anyhow::Result<T>) -> Result<T, Problem> {
        let watched = self.watched(run)?;
        let mut watched = watched.lock().unwrap_or_else(PoisonError::into_inner);
        ask(&mut watched).map_err(|error| match error.downcast::<Problem>() {
            Ok(problem) => problem,
            Err(error) => Problem::Unreadable(format!("{error:#}")),
        })
    }
}

impl Runs for Gallery {
    fn list(&self) -> Vec<Card> {
        let mut list = self.list.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((made, cards)) = &*list
            && made.elapsed() < LIST_EVERY
        {
            return cards.clone();
        }
        let card = |entry: Entry| {
            let read = self.with(&entry.id, Watched::card);
            read.unwrap_or_else(|problem| Card { problem: Some(problem.to_string()), ..entry.card() })
        };
        let mut cards: Vec<Card> = self.entries().into_iter().map(card).collect();
        cards.sort_by(|a, b| b.created_unix_s.cmp(&a.created_unix_s).then_with(|| a.id.cmp(&b.id)));
        *list = Some((Instant::now(), cards.clone()));
        cards
    }

    fn live(&self, run: &str) -> Result<Live, Problem> {
        self.with(run, Watched::live)
    }

    fn curves(&self, run: &str, edition: u64, known: usize) -> Result<Curves, Problem> {
        self.with(run, |watched| watched.curves(edition, known))
    }

    fn episodes(&self, run: &str, query: &EpisodeQuery) -> Result<EpisodePage, Problem> {
        self.with(run, |watched| watched.episodes(query))
    }

    fn recorded(&self, run: &str, key: EpisodeKey) -> Result<(ReplaySetup, RecordedEpisode), Problem> {
        self.with(run, |watched| watched.recorded(key))
    }

    fn newest(&self, run: &str, kitchen: u32, environment: u32) -> Result<Option<EpisodeKey>, Problem> {
        self.with(run, |watched| Ok(watched.newest(kitchen, environment)))
    }

    fn feed(&self, run: &str) -> Result<Box<dyn Feed>, Problem> {
        let found = self.entries().into_iter().find(|entry| entry.id == run);
        let entry = found.ok_or_else(|| Problem::NotThere(format!("there is no run called {run}")))?;
        Ok(Box::new(live::Recordings::of(entry.folder)))
    }
}
