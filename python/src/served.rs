//! Environments of Python, called step by step.

use crate::numbers;
use engine::guest::{Guest, Source};
use proto::record::HOLD;
use proto::task::Spec;
use pyo3::exceptions::PySystemExit;
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

/// An observation's channel, and its key in the dictionary of observations; none where the observation is the array.
pub type Observed = (String, Option<String>);

/// Environments of a run.
pub struct Served {
    /// What the environment observes, and what its `info` holds, by their keys.
    observed: Vec<(Source, Option<String>)>,
    of_info: Vec<(Source, Option<String>)>,
    reward: Option<Source>,
    environments: Vec<Environment>,
    /// Vector environments: their first column, how many columns they have, and what steps them.
    vectors: Vec<(usize, usize, Py<PyAny>)>,
}

/// One environment, or a column of a vector environment.
struct Environment {
    reset: Py<PyAny>,
    step: Py<PyAny>,
}

impl Served {
    /// Python's `environments` in a run of a task. `vectors` are those whose columns they are, first to last.
    pub fn new(
        environments: &[Bound<'_, PyAny>],
        vectors: &[Bound<'_, PyAny>],
        observed: &[Observed],
        spec: &Spec,
    ) -> PyResult<Self> {
        let environment = |environment: &Bound<'_, PyAny>| {
            let method = |name: &str| Ok::<_, PyErr>(environment.getattr(name)?.unbind());
            Ok(Environment { reset: method("reset")?, step: method("step")? })
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
            environments: environments.iter().map(environment).collect::<PyResult<_>>()?,
            vectors: vectors.iter().map(vector).collect::<PyResult<_>>()?,
        })
    }
}

impl Guest for Served {
    fn reset(&mut self, index: usize, seed: u32, record: &mut [u8]) -> Result<(), String> {
        Python::attach(|py| {
            let arguments = PyDict::new(py);
            let returned = arguments.set_item(intern!(py, "seed"), seed);
            let reset = self.environments[index].reset.bind(py);
            let returned = returned.and_then(|()| reset.call((), Some(&arguments)));
            let returned = returned.map_err(|error| raised(py, "reset", &error))?;
            let (observation, info): (Bound<'_, PyAny>, Bound<'_, PyAny>) =
                returned.extract().map_err(|_| "reset() returned no observation with an info".to_owned())?;
            take_in(&self.observed, &observation, record)?;
            let states = self.of_info.iter().filter(|(source, _)| !source.channel.is_of_action());
            take_in(states, &info, record)
        })
    }

    fn step_together(&mut self, first: usize, actions: &[u8]) -> Result<(), String> {
        let range = first..first + actions.len();
        for (column, columns, take) in &self.vectors {
            // Of a replay there is one environment, a column among others.
            let Some(actions) = (range.contains(column)).then(|| &actions[column - first..]) else { continue };
            Python::attach(|py| {
                let numbers = actions.iter().take(*columns).map(|&action| (action != HOLD).then_some(action));
                let taken = take.bind(py).call1((numbers.collect::<Vec<_>>(),));
                taken.map(|_| ()).map_err(|error| raised(py, "step", &error))
            })?;
        }
        Ok(())
    }

    fn step(&mut self, index: usize, action: u8, record: &mut [u8]) -> Result<[bool; 2], String> {
        Python::attach(|py| {
            let returned = self.environments[index].step.bind(py).call1((action,));
            let returned = returned.map_err(|error| raised(py, "step", &error))?;
            let returned = returned.cast_into::<PyTuple>().ok().filter(|returned| returned.len() == 5);
            let returned =
                returned.ok_or("step() did not return (observation, reward, terminated, truncated, info)")?;
            let [observation, reward, terminated, truncated, info] =
                std::array::from_fn(|at| returned.get_item(at).unwrap_or_else(|_| py.None().into_bound(py)));
            take_in(&self.observed, &observation, record)?;
            if let Some(Source { field, .. }) = &self.reward {
                numbers::write(&reward, &[], *field, record).map_err(|wrong| format!("its reward is {wrong}"))?;
            }
            take_in(&self.of_info, &info, record)?;
            let [terminated, truncated] = [("terminated", terminated), ("truncated", truncated)]
                .map(|(name, value)| value.is_truthy().map_err(|_| format!("`{name}` is neither true nor false")));
            Ok([terminated?, truncated?])
        })
    }
}

/// Writes channels into a record.
fn take_in<'a>(
    sources: impl IntoIterator<Item = &'a (Source, Option<String>)>,
    from: &Bound<'_, PyAny>,
    record: &mut [u8],
) -> Result<(), String> {
    for (Source { channel, field }, key) in sources {
        let name = &channel.name;
        let value = match key {
            None => from.clone(),
            Some(key) => from.get_item(key).map_err(|_| format!("it gives no `{key}`"))?,
        };
        numbers::write(&value, &channel.shape, *field, record).map_err(|wrong| format!("its `{name}` is {wrong}"))?;
    }
    Ok(())
}

/// That a method raised an exception. Its traceback goes to the log.
fn raised(py: Python<'_>, method: &str, error: &PyErr) -> String {
    if error.is_instance_of::<PySystemExit>(py) {
        return format!("{method}() asked Python to exit ({})", error.value(py));
    }
    error.display(py);
    format!("{method}() raised {error}")
}
