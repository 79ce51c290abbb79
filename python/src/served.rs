//! Environments of Python, called step by step.

use crate::numbers;
use engine::guest::{Guest, Record, Source};
use numpy::PyArray1;
use proto::task::{Field, Spec};
use pyo3::exceptions::PySystemExit;
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyTuple};

/// An observation's channel, and its key in the dictionary of observations; none where the observation is the array.
pub type Observed = (String, Option<String>);

/// Environments of a run.
pub struct Served {
    /// What the environment observes, and what its `info` holds, by their keys.
    observed: Vec<(Source, Option<String>)>,
    of_info: Vec<(Source, Option<String>)>,
    reward: Option<Source>,
    actions: ActionForm,
    /// In place of an action.
    hold: Vec<u8>,
    environments: Vec<Environment>,
    /// Vector environments: their first column, how many columns they have, and what steps them.
    vectors: Vec<(usize, usize, Py<PyAny>)>,
}

/// One environment, or a column of a vector environment.
struct Environment {
    reset: Py<PyAny>,
    step: Py<PyAny>,
    /// Of a task that is restored by snapshots: `get_state` and `set_state`.
    snapshots: Option<[Py<PyAny>; 2]>,
    /// What it observed last, if it is shown again.
    seen: Option<Py<PyAny>>,
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

impl Served {
    /// Python's `environments` in a run of a task. `vectors` are those whose columns they are, first to last.
    pub fn new(
        environments: &[Bound<'_, PyAny>],
        vectors: &[Bound<'_, PyAny>],
        observed: &[Observed],
        spec: &Spec,
    ) -> PyResult<Self> {
        let has_snapshots = !spec.layout().snapshot.is_empty();
        let environment = |environment: &Bound<'_, PyAny>| {
            let method = |name: &str| Ok::<_, PyErr>(environment.getattr(name)?.unbind());
            let snapshots = || Ok::<_, PyErr>([method("get_state")?, method("set_state")?]);
            let snapshots = has_snapshots.then(snapshots).transpose()?;
            Ok(Environment { reset: method("reset")?, step: method("step")?, snapshots, seen: None })
        };
        let mut first = 0;
        let vector = |vector: &Bound<'_, PyAny>| {
            let columns: usize = vector.len()?;
            first += columns;
            Ok((first - columns, columns, vector.getattr("take")?.unbind()))
        };
        let named = |(name, key): &Observed| Some((Source::of(spec, name)?, key.clone()));
        let keyed = |source: Source| (source.clone(), Some(source.channel.name));
        Ok(Self {
            observed: observed.iter().filter_map(named).collect(),
            of_info: Source::reported(spec).into_iter().map(keyed).collect(),
            reward: Source::reward(spec),
            actions: ActionForm::of(environments, spec.layout().action, spec)?,
            hold: spec.actions.hold(),
            environments: environments.iter().map(environment).collect::<PyResult<_>>()?,
            vectors: vectors.iter().map(vector).collect::<PyResult<_>>()?,
        })
    }
}

impl Served {
    /// Keeps what was observed, if it has images and is shown again.
    fn keep(&mut self, index: usize, observation: Bound<'_, PyAny>) {
        let has_images = self.observed.iter().any(|(source, _)| source.channel.is_bulk());
        self.environments[index].seen = (has_images && self.shows_again()).then(|| observation.unbind());
    }
}

impl Guest for Served {
    fn reset(&mut self, index: usize, seed: u32, mut record: Record<'_>) -> Result<(), String> {
        Python::attach(|py| {
            let arguments = PyDict::new(py);
            let returned = arguments.set_item(intern!(py, "seed"), seed);
            let reset = self.environments[index].reset.bind(py);
            let returned = returned.and_then(|()| reset.call((), Some(&arguments)));
            let returned = returned.map_err(|error| raised(py, "reset", &error))?;
            let [observation, info] = values("reset", &returned)?;
            take_in(&self.observed, &observation, &mut record)?;
            let states = self.of_info.iter().filter(|(source, _)| !source.channel.is_of_action());
            take_in(states, &info, &mut record)?;
            self.keep(index, observation);
            Ok(())
        })
    }

    fn step_together(&mut self, first: usize, actions: &[u8]) -> Result<(), String> {
        let bytes = self.hold.len();
        let range = first..first + actions.len() / bytes;
        for (column, columns, take) in &self.vectors {
            // Of a replay there is one environment, a column among others.
            let Some(actions) = (range.contains(column)).then(|| &actions[(column - first) * bytes..]) else {
                continue;
            };
            Python::attach(|py| {
                let each = actions.chunks_exact(bytes).take(*columns);
                let value = |action: &[u8]| (action != self.hold).then(|| self.actions.value(py, action)).transpose();
                let values = each.map(value).collect::<PyResult<Vec<_>>>();
                let taken = values.and_then(|values| take.bind(py).call1((values,)));
                taken.map(|_| ()).map_err(|error| raised(py, "step", &error))
            })?;
        }
        Ok(())
    }

    fn step(&mut self, index: usize, action: &[u8], mut record: Record<'_>) -> Result<[bool; 2], String> {
        Python::attach(|py| {
            let step = self.environments[index].step.bind(py);
            let returned = self.actions.value(py, action).and_then(|action| step.call1((action,)));
            let returned = returned.map_err(|error| raised(py, "step", &error))?;
            let [observation, reward, terminated, truncated, info] = values("step", &returned)?;
            let ended = [terminated, truncated].map(|value| value.extract::<bool>().ok());
            let [Some(terminated), Some(truncated)] = ended else { return Err(problem("step", &returned)) };
            take_in(&self.observed, &observation, &mut record)?;
            if let Some(Source { channel, field }) = &self.reward {
                let written = numbers::write(&reward, &[], *field, record.piece(channel));
                written.map_err(|wrong| format!("step()'s reward is {wrong}"))?;
            }
            take_in(&self.of_info, &info, &mut record)?;
            self.keep(index, observation);
            Ok([terminated, truncated])
        })
    }

    /// A vector is stepped as a whole, and may write over what a column that is held has observed.
    fn shows_again(&self) -> bool {
        self.vectors.is_empty()
    }

    fn show_again(&mut self, index: usize, mut record: Record<'_>) -> Result<(), String> {
        Python::attach(|py| {
            let seen = self.environments[index].seen.as_ref().ok_or("it has observed nothing")?;
            let images = self.observed.iter().filter(|(source, _)| source.channel.is_bulk());
            take_in(images, seen.bind(py), &mut record)
        })
    }

    fn snapshot(&mut self, index: usize) -> Result<Vec<u8>, String> {
        let methods = self.environments[index].snapshots.as_ref();
        Python::attach(|py| {
            let [get_state, _] = methods.ok_or("it has no get_state()")?;
            let state = get_state.bind(py).call0().map_err(|error| raised(py, "get_state", &error))?;
            let bytes = state.cast_into::<PyBytes>().map_err(|_| "get_state() returned no bytes".to_owned())?;
            Ok(bytes.as_bytes().to_vec())
        })
    }

    fn restore(&mut self, index: usize, snapshot: &[u8]) -> Result<(), String> {
        let methods = self.environments[index].snapshots.as_ref();
        Python::attach(|py| {
            let [_, set_state] = methods.ok_or("it has no set_state()")?;
            let called = set_state.bind(py).call1((PyBytes::new(py, snapshot),));
            called.map(drop).map_err(|error| raised(py, "set_state", &error))
        })
    }
}

/// What a method returned, if it has as many values as Gymnasium says.
fn values<'py, const COUNT: usize>(
    method: &str,
    returned: &Bound<'py, PyAny>,
) -> Result<[Bound<'py, PyAny>; COUNT], String> {
    let py = returned.py();
    match returned.cast::<PyTuple>() {
        Ok(tuple) if tuple.len() == COUNT => {
            Ok(std::array::from_fn(|at| tuple.get_item(at).unwrap_or_else(|_| py.None().into_bound(py))))
        }
        _ => Err(problem(method, returned)),
    }
}

/// What is wrong with what a method returned, as the trial before a run says it.
fn problem(method: &str, returned: &Bound<'_, PyAny>) -> String {
    let module = returned.py().import("stillroom.returned");
    let said = module.and_then(|module| module.call_method1("problem", (method, returned)));
    said.map_or_else(|error| error.to_string(), |said| said.to_string())
}

/// Writes channels into a record.
fn take_in<'a>(
    sources: impl IntoIterator<Item = &'a (Source, Option<String>)>,
    from: &Bound<'_, PyAny>,
    record: &mut Record<'_>,
) -> Result<(), String> {
    for (Source { channel, field }, key) in sources {
        let name = &channel.name;
        let value = match key {
            None => from.clone(),
            Some(key) => from.get_item(key).map_err(|_| format!("it gives no `{key}`"))?,
        };
        let written = numbers::write(&value, &channel.shape, *field, record.piece(channel));
        written.map_err(|wrong| format!("its `{name}` is {wrong}"))?;
    }
    Ok(())
}

/// That a method raised an exception, and where. Its traceback goes to the log.
fn raised(py: Python<'_>, method: &str, error: &PyErr) -> String {
    if error.is_instance_of::<PySystemExit>(py) {
        return format!("{method}() called sys.exit({})", error.value(py));
    }
    error.display(py);
    let told = py.import("stillroom.fault").and_then(|fault| fault.call_method1("told", (error.value(py),)));
    format!("{method}() raised {}", told.map_or_else(|_| error.to_string(), |told| told.to_string()))
}
