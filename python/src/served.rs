//! Environments of Python, as the engine runs them.

use crate::numbers;
use engine::Simulator;
use numpy::PyArray1;
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::evaluation::{Plan, seed_of};
use proto::kitchen::Split;
use proto::last_place::LastPlace;
use proto::random::Key;
use proto::record::{End, RecordHeader};
use proto::task::{Channel, Check, Field, Layout, REWARD, Role, Spec};
use pyo3::exceptions::PySystemExit;
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyTuple};
use std::fs::File;
use std::os::unix::fs::FileExt;
use wire::message::{Line, Snapshot};
use xxhash_rust::xxh3::Xxh3;

/// An environment failed.
#[derive(Debug, thiserror::Error)]
#[error("{place}: {problem}")]
pub struct Failure {
    place: LastPlace,
    problem: String,
}

/// Environments of a run.
pub struct Served {
    seed: u64,
    /// An evaluation's episodes, and whether they are the test's or validation's.
    plan: Option<(Plan, Split)>,
    max_steps: u32,
    layout: &'static Layout,
    check: Check,
    /// What the environment observes, and what its `info` holds.
    observed: Vec<Source>,
    of_info: Vec<Source>,
    reward: Option<Field>,
    actions: ActionForm,
    environments: Vec<Environment>,
    /// Where the last place is kept, for whoever finds an actor dead.
    last_place: Option<File>,
}

/// Where a channel's numbers come from.
struct Source {
    channel: Channel,
    field: Field,
    /// The key in a dictionary; none where the observation is the array itself.
    key: Option<String>,
}

/// One environment.
struct Environment {
    reset: Py<PyAny>,
    step: Py<PyAny>,
    number: u32,
    episode: u32,
    steps: u32,
    /// All that was seen and done in this episode so far.
    history: Xxh3,
    state_hash: u64,
    /// Of a task that is restored by snapshots: bound methods.
    snapshots: Option<[Py<PyAny>; 2]>,
    /// The record as it is now, but for its header and actions.
    record: Vec<Line>,
}

/// How an action's bytes become what `step` is given.
enum ActionForm {
    /// The number of one of them.
    Number,
    /// An array of this shape and type, which the action space has.
    Array { field: Field, shape: Py<PyAny>, dtype: Py<PyAny> },
}

impl ActionForm {
    fn of(environments: &[Bound<'_, PyAny>], field: Field, spec: &Spec) -> PyResult<Self> {
        let Some(first) = environments.first().filter(|_| spec.actions.names().is_empty()) else {
            return Ok(Self::Number);
        };
        let space = first.getattr("action_space")?;
        let [shape, dtype] = ["shape", "dtype"].map(|name| space.getattr(name).map(Bound::unbind));
        Ok(Self::Array { field, shape: shape?, dtype: dtype? })
    }

    fn value<'py>(&self, py: Python<'py>, action: &[u8]) -> PyResult<Bound<'py, PyAny>> {
        let Self::Array { field, shape, dtype } = self else {
            return Ok(action.first().copied().unwrap_or_default().into_pyobject(py)?.into_any());
        };
        let numbers = action.chunks_exact(field.dtype.bytes()).map(|bytes| field.dtype.read(bytes));
        // Exact: numbers have 32 bits.
        let array = PyArray1::from_iter(py, numbers);
        array.call_method1("astype", (dtype,))?.call_method1("reshape", (shape,))
    }
}

/// An observation's channel, and its key in the dictionary of observations.
pub type Observed = (String, Option<String>);

impl Served {
    /// Python's `environments` in a run of this configuration.
    pub fn new(
        environments: &[Bound<'_, PyAny>],
        observed: &[Observed],
        last_place: Option<File>,
        config: &Config,
    ) -> PyResult<Self> {
        let spec = config.spec();
        let layout = spec.layout();
        let source = |name: &str, key: Option<String>| {
            let (channel, field) = spec.channel(name)?;
            Some(Source { channel: channel.clone(), field, key })
        };
        let is_of_info = |channel: &&Channel| channel.role != Role::Observation && channel.name != REWARD;
        let of_info = spec.channels.iter().filter(is_of_info);
        let lines = layout.bytes / size_of::<Line>();
        let has_snapshots = !layout.snapshot.is_empty();
        let snapshots = |environment: &Bound<'_, PyAny>| -> PyResult<_> {
            Ok([environment.getattr("get_state")?.unbind(), environment.getattr("set_state")?.unbind()])
        };
        let environment = |environment: &Bound<'_, PyAny>| {
            Ok(Environment {
                reset: environment.getattr("reset")?.unbind(),
                step: environment.getattr("step")?.unbind(),
                number: 0,
                episode: 0,
                steps: 0,
                history: Xxh3::new(),
                state_hash: 0,
                snapshots: has_snapshots.then(|| snapshots(environment)).transpose()?,
                record: vec![Line([0; 64]); lines],
            })
        };
        Ok(Self {
            seed: config.seed,
            plan: config.evaluation_plan().zip(config.evaluation.as_ref().map(|asked| asked.split)),
            max_steps: config.episode.max_steps,
            layout,
            check: Check::of(spec),
            observed: observed.iter().filter_map(|(name, key)| source(name, key.clone())).collect(),
            of_info: of_info.filter_map(|channel| source(&channel.name, Some(channel.name.clone()))).collect(),
            reward: spec.channel(REWARD).map(|(_, field)| field),
            actions: ActionForm::of(environments, layout.action, spec)?,
            environments: environments.iter().map(environment).collect::<PyResult<_>>()?,
            last_place,
        })
    }

    /// The number of an episode wherever it is told of, and the seed that it begins with.
    fn which(&self, home: EnvironmentId, episode: u32) -> (u32, u32) {
        match &self.plan {
            None => (episode, Key::episode_seed(self.seed, home.number, episode)),
            Some((plan, split)) => {
                // One that has run out is not asked to act.
                let dealt = plan.dealt(home, episode).unwrap_or_default();
                (dealt, seed_of(*split, dealt))
            }
        }
    }

    /// Says where this process is, before Python is called: it may not return.
    fn enter(&self, place: LastPlace) {
        // A disk that is full stops the run elsewhere; this file is a courtesy.
        let _ = self.last_place.as_ref().map(|file| file.write_all_at(&place.to_bytes(), 0));
    }

    /// Copies what is seen now of an environment, but for images.
    pub fn copy_seen(&self, index: usize, seen: &mut [u8]) {
        seen.copy_from_slice(&Line::bytes(&self.environments[index].record)[self.layout.seen.clone()]);
    }
}

impl Environment {
    fn place(&self) -> LastPlace {
        LastPlace { environment: self.number, episode: self.episode, step: self.steps }
    }
}

impl Simulator for Served {
    type Error = Failure;

    fn begin(&mut self, index: usize, home: EnvironmentId, episode: u32) -> Result<u64, Failure> {
        let (told, seed) = self.which(home, episode);
        let one = &mut self.environments[index];
        (one.number, one.episode, one.steps) = (home.number, told, 0);
        one.history = Xxh3::new();
        let place = one.place();
        self.enter(place);
        Python::attach(|py| {
            let one = &mut self.environments[index];
            let arguments = PyDict::new(py);
            let returned = arguments.set_item(intern!(py, "seed"), seed);
            let returned = returned.and_then(|()| one.reset.bind(py).call((), Some(&arguments)));
            let returned = returned.map_err(|error| raised(py, "reset", &error))?;
            let (observation, info): (Bound<'_, PyAny>, Bound<'_, PyAny>) =
                returned.extract().map_err(|_| "reset() returned no observation with an info".to_owned())?;
            take_in(&self.observed, &observation, Line::bytes_mut(&mut one.record))?;
            let states = self.of_info.iter().filter(|source| !source.channel.is_of_action());
            take_in(states, &info, Line::bytes_mut(&mut one.record))?;
            check(&self.check, one, false, self.layout)
        })
        .map_err(|problem| Failure { place, problem })
    }

    fn restore(
        &mut self,
        index: usize,
        home: EnvironmentId,
        episode: u32,
        step: u32,
        snapshot: &Snapshot,
    ) -> Result<(), Failure> {
        let (told, _) = self.which(home, episode);
        let one = &mut self.environments[index];
        (one.number, one.episode, one.steps) = (home.number, told, step);
        one.state_hash = snapshot.state_hash;
        let place = one.place();
        self.enter(place);
        let set_state = self.environments[index].snapshots.as_ref().map(|[_, set_state]| set_state);
        let restored = Python::attach(|py| {
            let set_state = set_state.ok_or_else(|| "it has no set_state()".to_owned())?;
            let called = set_state.bind(py).call1((PyBytes::new(py, &snapshot.bytes),));
            called.map(drop).map_err(|error| raised(py, "set_state", &error))
        });
        restored.map_err(|problem| Failure { place, problem })
    }

    fn act(&mut self, index: usize, action: &[u8], done: &mut [u8]) -> Result<(u64, Option<End>), Failure> {
        let place = self.environments[index].place();
        self.enter(place);
        let result = Python::attach(|py| {
            let one = &mut self.environments[index];
            let action = self.actions.value(py, action).map_err(|error| raised(py, "step", &error))?;
            let returned = one.step.bind(py).call1((action,)).map_err(|error| raised(py, "step", &error))?;
            let returned = returned.cast_into::<PyTuple>().ok().filter(|returned| returned.len() == 5);
            let returned =
                returned.ok_or("step() did not return (observation, reward, terminated, truncated, info)")?;
            let [observation, reward, terminated, truncated, info] =
                std::array::from_fn(|at| returned.get_item(at).unwrap_or_else(|_| py.None().into_bound(py)));
            let record = Line::bytes_mut(&mut one.record);
            take_in(&self.observed, &observation, record)?;
            if let Some(field) = self.reward {
                numbers::write(&reward, &[], field, record).map_err(|wrong| format!("its reward is {wrong}"))?;
            }
            take_in(&self.of_info, &info, record)?;
            let [terminated, truncated] = [("terminated", terminated), ("truncated", truncated)]
                .map(|(name, value)| value.is_truthy().map_err(|_| format!("`{name}` is neither true nor false")));
            one.steps += 1;
            let end = match (terminated?, truncated? || one.steps >= self.max_steps) {
                (true, _) => Some(End::Terminated),
                (false, true) => Some(End::Truncated),
                (false, false) => None,
            };
            let hash = check(&self.check, one, true, self.layout)?;
            done.copy_from_slice(&Line::bytes(&one.record)[self.layout.of_action.clone()]);
            Ok((hash, end))
        });
        result.map_err(|problem: String| Failure { place, problem })
    }

    fn observe(&mut self, index: usize, header: &mut RecordHeader, record: &mut [u8]) -> Result<(), Failure> {
        self.copy_seen(index, &mut record[self.layout.seen.clone()]);
        let seen = Line::bytes(&self.environments[index].record);
        for source in self.observed.iter().chain(&self.of_info).filter(|source| source.channel.is_bulk()) {
            let range = source.field.range();
            record[range.clone()].copy_from_slice(&seen[range]);
            let bit = self.layout.images.iter().position(|&image| image == source.field);
            header.bulk |= bit.map_or(0, |bit| 1 << bit);
        }
        let one = &self.environments[index];
        let Some([get_state, _]) = &one.snapshots else { return Ok(()) };
        let place = one.place();
        self.enter(place);
        let taken = Python::attach(|py| {
            let state = get_state.bind(py).call0().map_err(|error| raised(py, "get_state", &error))?;
            let bytes = state.cast_into::<PyBytes>().map_err(|_| "get_state() returned no bytes".to_owned())?;
            let fits = !bytes.as_bytes().is_empty() && self.layout.write_snapshot(bytes.as_bytes(), record);
            let problem = || format!("get_state() returned {} bytes, which is none or more", bytes.as_bytes().len());
            fits.then_some(()).ok_or_else(|| format!("{} than are declared", problem()))
        });
        taken.map_err(|problem| Failure { place, problem })
    }
}

/// Writes channels into a record.
fn take_in<'a>(
    sources: impl IntoIterator<Item = &'a Source>,
    from: &Bound<'_, PyAny>,
    record: &mut [u8],
) -> Result<(), String> {
    for Source { channel, field, key } in sources {
        let name = &channel.name;
        let value = match key {
            None => from.clone(),
            Some(key) => from.get_item(key).map_err(|_| format!("it gives no `{key}`"))?,
        };
        numbers::write(&value, &channel.shape, *field, record).map_err(|wrong| format!("its `{name}` is {wrong}"))?;
    }
    Ok(())
}

/// Refuses numbers that the task does not declare; returns the state's hash: of all that was seen and done so far.
fn check(check: &Check, one: &mut Environment, acted: bool, layout: &Layout) -> Result<u64, String> {
    let record = Line::bytes(&one.record);
    check.record(record, acted).map_err(|problem| problem.to_string())?;
    if one.snapshots.is_some() && acted {
        // A chain, which goes on from a snapshot.
        one.history = Xxh3::with_seed(one.state_hash);
    }
    one.history.update(&record[layout.seen.start..]);
    if acted {
        one.history.update(&record[layout.of_action.clone()]);
    }
    one.state_hash = one.history.digest();
    Ok(one.state_hash)
}

/// That a method raised an exception. Its traceback goes to the log.
fn raised(py: Python<'_>, method: &str, error: &PyErr) -> String {
    if error.is_instance_of::<PySystemExit>(py) {
        return format!("{method}() asked Python to exit ({})", error.value(py));
    }
    error.display(py);
    format!("{method}() raised {error}")
}
