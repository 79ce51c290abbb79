//! Arguments from Python. Each is refused in one sentence that names it and says what it may be.

use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyBool;
use std::path::PathBuf;

/// Characters of a value that an error shows.
const SHOWN_MOST: usize = 60;

/// An integer from `least` to `most`: all that Python can index with, but no bool.
#[pyfunction]
#[pyo3(signature = (name, value, most, least=0))]
pub fn whole(name: &str, value: &Bound<'_, PyAny>, most: u64, least: u64) -> PyResult<u64> {
    let index = value.py().import("operator")?.getattr("index")?;
    let number = if value.is_instance_of::<PyBool>() { None } else { index.call1((value,)).ok() };
    let number = number.ok_or_else(|| PyTypeError::new_err(format!("{name} is {}, not an integer", shown(value))))?;
    let fits = number.extract().ok().filter(|number| (least..=most).contains(number));
    fits.ok_or_else(|| PyValueError::new_err(format!("{name} is {}, not {least} to {most}", shown(&number))))
}

/// One of a few texts.
#[pyfunction]
pub fn choice(name: &str, value: &Bound<'_, PyAny>, choices: Vec<String>) -> PyResult<String> {
    let choices: Vec<_> = choices.into_iter().map(|choice| (choice.clone(), choice)).collect();
    chosen(name, value, &choices)
}

/// What one of a few texts stands for.
pub fn chosen<N: AsRef<str>, T: Clone>(name: &str, value: &Bound<'_, PyAny>, choices: &[(N, T)]) -> PyResult<T> {
    let text: Option<String> = value.extract().ok();
    let found = choices.iter().find(|(choice, _)| text.as_deref() == Some(choice.as_ref()));
    found.map(|(_, meant)| meant.clone()).ok_or_else(|| {
        let known: Vec<String> = choices.iter().map(|(choice, _)| format!("\"{}\"", choice.as_ref())).collect();
        PyValueError::new_err(format!("{name} is {}, none of {}", shown(value), known.join(", ")))
    })
}

/// A number as 32 bits; whether it is finite and in its range is for the configuration to say.
pub fn real(name: &str, value: &Bound<'_, PyAny>) -> PyResult<f32> {
    let number: Option<f64> = if value.is_instance_of::<PyBool>() { None } else { value.extract().ok() };
    let number = number.ok_or_else(|| PyTypeError::new_err(format!("{name} is {}, not a number", shown(value))))?;
    Ok(number as f32)
}

pub fn text(name: &str, value: &Bound<'_, PyAny>) -> PyResult<String> {
    value.extract().map_err(|_| PyTypeError::new_err(format!("{name} is {}, not a text", shown(value))))
}

pub fn path(name: &str, value: &Bound<'_, PyAny>) -> PyResult<PathBuf> {
    value.extract().map_err(|_| PyTypeError::new_err(format!("{name} is {}, not a path", shown(value))))
}

/// A value for an error: as Python writes it, but no more than a line.
#[pyfunction]
pub fn shown(value: &Bound<'_, PyAny>) -> String {
    let text = value.repr().ok().and_then(|text| text.extract::<String>().ok());
    // Python writes no integer of more than 4,300 digits.
    let text = text.unwrap_or_else(|| format!("<{}>", value.get_type()));
    let short: String = text.split_whitespace().collect::<Vec<_>>().join(" ").chars().take(SHOWN_MOST).collect();
    if short.len() < text.len() { format!("{short}...") } else { short }
}
