//! What `orchestrator view` shows of runs: [`view::data::Runs`] from their folders alone. Of each run that is looked at,
//! [`watched`] keeps what was read, and reads only what is new.

mod episode_table;
pub mod logbook;
mod process_log;
mod processes;
mod roster;
pub mod tail;
mod watched;

use crate::suite::{At, Standing};
use proto::bounded::RESULT_BYTES_MOST;
use proto::run_folder::RunFolder;
use roster::{Entry, Roster};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};
use view::data::{
    Card, Curves, EpisodeKey, EpisodePage, EpisodeQuery, Film, Live, Pairs, Problem, Recorded, Runs, SuiteRun,
    SuiteStanding,
};
use watched::Watched;

const LIST_EVERY: Duration = Duration::from_secs(2);
const LISTERS: usize = 4;
/// Who asks about a run waits for this long: its folder can be anybody's, and its disk can hang.
const PATIENCE: Duration = Duration::from_secs(5);
const TURN: Duration = Duration::from_secs(3);

/// Runs in folders. Each is read on a thread of its own, so that none waits for another.
pub struct RunReaders {
    roster: Mutex<Roster>,
    readers: Mutex<HashMap<String, Arc<RunReader>>>,
    list: Mutex<Option<(Instant, Vec<Card>)>>,
    /// The list waits for a run, and for all together.
    patience: [Duration; 2],
    turn: AtomicUsize,
}

struct RunReader {
    entry: Entry,
    watched: Mutex<Option<Box<Watched>>>,
    free: Condvar,
    card: Mutex<Card>,
}

struct Reading {
    reader: Arc<RunReader>,
    watched: Option<Box<Watched>>,
}

impl Drop for Reading {
    fn drop(&mut self) {
        let watched = self.watched.take().filter(|_| !std::thread::panicking());
        let watched = watched.unwrap_or_else(|| Box::new(Watched::of(self.reader.entry.clone())));
        *self.reader.watched.lock().unwrap_or_else(PoisonError::into_inner) = Some(watched);
        self.reader.free.notify_one();
    }
}

impl RunReader {
    fn of(entry: Entry) -> Arc<Self> {
        let watched = Mutex::new(Some(Box::new(Watched::of(entry.clone()))));
        let card = Card { problem: Some("it waits to be read".to_owned()), ..entry.card() };
        Arc::new(Self { entry, watched, free: Condvar::new(), card: Mutex::new(card) })
    }

    fn ask<T: Send + 'static>(
        self: &Arc<Self>,
        until: Instant,
        ask: impl FnOnce(&mut Watched) -> anyhow::Result<T> + Send + 'static,
    ) -> Result<T, Problem> {
        let left = || until.saturating_duration_since(Instant::now());
        let slow = || {
            let folder = self.entry.folder.root().display();
            Problem::NotYet(format!("{folder} is still being read: it is large, or the disk or processor is busy"))
        };
        let watched = self.watched.lock().unwrap_or_else(PoisonError::into_inner);
        let free = self.free.wait_timeout_while(watched, left().min(TURN), |watched| watched.is_none());
        let watched = free.unwrap_or_else(PoisonError::into_inner).0.take().ok_or_else(slow)?;
        let mut reading = Reading { reader: Arc::clone(self), watched: Some(watched) };
        let (sender, answer) = sync_channel(1);
        let read = move || {
            let answer = reading.watched.as_deref_mut().map(ask);
            // First: whoever has the answer asks again.
            drop(reading);
            let _ = sender.send(answer);
        };
        let failed = |cause: &str| Problem::Unreadable(format!("reading {} failed: {cause}", self.entry.id));
        std::thread::Builder::new()
            .name("reading".to_owned())
            .spawn(read)
            .map_err(|error| failed(&error.to_string()))?;
        match answer.recv_timeout(left()) {
            Ok(Some(answer)) => answer.map_err(|error| match error.downcast::<Problem>() {
                Ok(problem) => problem,
                Err(error) => Problem::Unreadable(format!("{error:#}")),
            }),
            Err(RecvTimeoutError::Timeout) => Err(slow()),
            Ok(None) | Err(RecvTimeoutError::Disconnected) => Err(failed("see the terminal")),
        }
    }
}

impl RunReaders {
    pub fn of(paths: Vec<PathBuf>) -> Self {
        let patience = [Duration::from_secs(1), PATIENCE];
        let (roster, readers, list) = (Mutex::new(Roster::of(paths)), Mutex::default(), Mutex::default());
        Self { roster, readers, list, patience, turn: AtomicUsize::new(0) }
    }

    pub fn once(paths: Vec<PathBuf>) -> Self {
        Self { patience: [Duration::from_secs(30), Duration::from_mins(2)], ..Self::of(paths) }
    }

    pub fn count(&self) -> usize {
        self.entries().len()
    }

    pub fn names_of(&self, folders: &[PathBuf]) -> Vec<String> {
        let entries = self.entries();
        let name = |folder: &PathBuf| {
            let folder = RunFolder::new(folder);
            entries.iter().find(|entry| entry.folder == folder).map(|entry| entry.id.clone())
        };
        folders.iter().filter_map(name).collect()
    }

    /// The newest run, evaluations left out; of a suite what is at work before that.
    pub fn newest_run(&self, suite: bool) -> Option<Card> {
        let runs = self.list().into_iter().filter(|card| card.problem.is_none() && (suite || !card.evaluation));
        runs.min_by_key(|card| (suite && card.state != "running", card.evaluation))
    }

    fn entries(&self) -> Vec<Entry> {
        self.roster.lock().unwrap_or_else(PoisonError::into_inner).look()
    }

    fn reader(&self, entry: Entry) -> Arc<RunReader> {
        let mut readers = self.readers.lock().unwrap_or_else(PoisonError::into_inner);
        Arc::clone(readers.entry(entry.id.clone()).or_insert_with(|| RunReader::of(entry)))
    }

    fn with<T: Send + 'static>(
        &self,
        run: &str,
        ask: impl FnOnce(&mut Watched) -> anyhow::Result<T> + Send + 'static,
    ) -> Result<T, Problem> {
        let not_there = || Problem::NotThere(format!("there is no run called {run}"));
        let known = self.readers.lock().unwrap_or_else(PoisonError::into_inner).get(run).map(Arc::clone);
        let find = || self.entries().into_iter().find(|entry| entry.id == run).map(|entry| self.reader(entry));
        let reader = known.or_else(find).ok_or_else(not_there)?;
        let asked =
            reader.ask(
                Instant::now() + PATIENCE,
                |watched| {
                    if watched.is_there() { ask(watched).map(Some) } else { Ok(None) }
                },
            );
        asked?.ok_or_else(|| {
            self.readers.lock().unwrap_or_else(PoisonError::into_inner).remove(run);
            not_there()
        })
    }

    /// The folder of the suite that a run is of, and how it stands.
    fn suite_of(&self, run: &str) -> Result<(RunFolder, Standing), Problem> {
        let suite = self.with(run, |watched| Ok(watched.suite().map(Path::to_owned)))?;
        let suite = suite.ok_or_else(|| Problem::NotThere(format!("{run} is of no suite")))?;
        let standing = Standing::read(&suite).map_err(|error| Problem::Unreadable(format!("{error:#}")))?;
        Ok((RunFolder::new(suite), standing))
    }

    /// The cards of these runs, a few at a time. One that is slow, or for which no time is left, keeps its last, and those
    /// for which none was left come first the next time.
    fn cards(&self, entries: Vec<Entry>) -> Vec<Card> {
        let [of_one, of_all] = self.patience;
        let end = Instant::now() + of_all;
        let readers: Vec<Arc<RunReader>> = entries.into_iter().map(|entry| self.reader(entry)).collect();
        let (turn, next) = (self.turn.load(Ordering::Relaxed), AtomicUsize::new(0));
        let read = || {
            while Instant::now() < end {
                let number = next.fetch_add(1, Ordering::Relaxed);
                if number >= readers.len() {
                    return;
                }
                let reader = &readers[(turn + number) % readers.len()];
                let read = reader.ask(Instant::now() + of_one, move |watched| watched.card(of_one / 2));
                let unreadable = |problem: Problem| Card { problem: Some(problem.to_string()), ..reader.entry.card() };
                *reader.card.lock().unwrap_or_else(PoisonError::into_inner) = read.unwrap_or_else(unreadable);
            }
        };
        std::thread::scope(|scope| (0..LISTERS.min(readers.len())).for_each(|_| drop(scope.spawn(read))));
        let asked = next.into_inner();
        self.turn.store(if asked < readers.len() { turn + asked } else { 0 }, Ordering::Relaxed);
        readers.iter().map(|reader| reader.card.lock().unwrap_or_else(PoisonError::into_inner).clone()).collect()
    }
}

fn standing(suite: &Path) -> Option<SuiteStanding> {
    let standing = Standing::read(suite).ok()?;
    let report = standing.report().map(|page| page.display().to_string());
    Some(SuiteStanding { folder: suite.display().to_string(), counts: standing.counts(), report })
}

impl Runs for RunReaders {
    fn list(&self) -> Vec<Card> {
        let mut list = self.list.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((made, cards)) = &*list
            && made.elapsed() < LIST_EVERY
        {
            return cards.clone();
        }
        let (entries, left_out) = {
            let mut roster = self.roster.lock().unwrap_or_else(PoisonError::into_inner);
            (roster.look(), roster.left_out.clone())
        };
        let suites: Vec<Option<PathBuf>> = entries.iter().map(|entry| entry.suite.clone()).collect();
        let mut cards = self.cards(entries);
        let mut standings: HashMap<PathBuf, Option<SuiteStanding>> = HashMap::new();
        for (card, suite) in cards.iter_mut().zip(suites) {
            let standing = |suite| standings.entry(suite).or_insert_with_key(|suite| standing(suite)).clone();
            card.suite_standing = suite.and_then(standing);
        }
        cards.extend(left_out);
        cards.sort_by(|a, b| b.created_unix_s.cmp(&a.created_unix_s).then_with(|| a.id.cmp(&b.id)));
        *list = Some((Instant::now(), cards.clone()));
        cards
    }

    fn live(&self, run: &str) -> Result<Live, Problem> {
        self.with(run, Watched::live)
    }

    fn curves(&self, run: &str, edition: u64, known: usize) -> Result<Curves, Problem> {
        self.with(run, move |watched| watched.curves(edition, known))
    }

    fn episodes(&self, run: &str, query: &EpisodeQuery) -> Result<EpisodePage, Problem> {
        let query = query.clone();
        self.with(run, move |watched| watched.episodes(&query))
    }

    fn pairs(&self, [one, other]: [&str; 2]) -> Result<Pairs, Problem> {
        let recorded = [self.with(one, Watched::pairable)?, self.with(other, Watched::pairable)?];
        Ok(episode_table::pairs(&recorded))
    }

    fn recorded(&self, run: &str, key: EpisodeKey) -> Result<Recorded, Problem> {
        self.with(run, move |watched| watched.recorded(key))
    }

    fn newest(&self, run: &str, kitchen: u32, environment: u32) -> Result<Option<EpisodeKey>, Problem> {
        self.with(run, move |watched| Ok(watched.newest(kitchen, environment)))
    }

    fn report(&self, run: &str) -> Result<String, Problem> {
        let of_suite = || {
            let (folder, standing) = self.suite_of(run)?;
            let none = || Problem::NotThere(format!("{run} has no report, nor has its suite"));
            Ok((folder, standing.report().ok_or_else(none)?))
        };
        let own = self.with(run, |watched| Ok(watched.report()))?;
        let (folder, page) = own.map_or_else(of_suite, Ok)?;
        let unreadable = |cause: String| Problem::Unreadable(format!("{}: {cause}", page.display()));
        let bytes = folder.read(&page, RESULT_BYTES_MOST).map_err(|error| unreadable(error.to_string()))?;
        String::from_utf8(bytes).map_err(|error| unreadable(error.to_string()))
    }

    fn suite(&self, run: &str) -> Result<Vec<SuiteRun>, Problem> {
        let (_, standing) = self.suite_of(run)?;
        let run = |(folder, state, reason): At<'_>| {
            let name = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
            SuiteRun { name, state, reason: reason.map(str::to_owned) }
        };
        Ok(standing.each().into_iter().map(run).collect())
    }

    fn film(&self, run: &str, key: EpisodeKey) -> Result<Film, Problem> {
        self.with(run, move |watched| watched.film(key))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_that_is_read_for_ever_holds_up_no_other_and_comes_back() {
        let root = tempfile::tempdir().unwrap();
        for name in ["a", "b"] {
            std::fs::create_dir(root.path().join(name)).unwrap();
            std::fs::write(root.path().join(name).join("run.toml"), "").unwrap();
        }
        let readers = RunReaders::of(vec![root.path().to_owned()]);
        let (sender, gate) = sync_channel::<()>(0);
        let reader = readers.reader(readers.entries().remove(0));
        let soon = || Instant::now() + Duration::from_millis(50);
        let hangs = reader.ask(soon(), move |_| Ok(gate.recv().is_ok()));
        let problem = hangs.unwrap_err();
        assert!(matches!(&problem, Problem::NotYet(text) if text.contains("is still being read")), "{problem:?}");
        let began = Instant::now();
        assert_eq!(readers.with("b", |_| Ok(1)), Ok(1));
        let problems: Vec<bool> =
            readers.list().into_iter().map(|card| card.problem.unwrap().contains("is still being read")).collect();
        assert_eq!(problems, [true, false], "an empty run.toml is read, and is none");
        assert!(began.elapsed() < PATIENCE, "{:?}", began.elapsed());
        sender.send(()).unwrap();
        assert_eq!(readers.with("a", |_| Ok(2)), Ok(2));
        let panics = reader.ask(Instant::now() + PATIENCE, |_| -> anyhow::Result<()> { panic!("a planted fault") });
        assert!(panics.is_err());
        assert_eq!(readers.with("a", |_| Ok(3)), Ok(3), "it is read anew after that");
    }
}
