//! Files of a run folder, which may be anybody's. They are read as the programs read them: no link below the path that the
//! user named is followed, and each file has a bound.

use crate::argument;
use proto::bounded::{FIGURES_BYTES_MOST, RESULT_BYTES_MOST};
use proto::run_folder::{Item, RunFolder};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use std::path::PathBuf;

/// The bytes of `path`, a file in the folder `root`.
#[pyfunction]
pub fn read_of_run<'py>(root: &Bound<'py, PyAny>, path: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyBytes>> {
    let (py, folder) = (root.py(), RunFolder::new(argument::path("root", root)?));
    let path = argument::path("path", path)?;
    let read = || match path.extension().and_then(|extension| extension.to_str()) {
        Some("toml") => folder.read_text(&path).map(String::into_bytes),
        Some("json") => folder.read(&path, RESULT_BYTES_MOST),
        _ => folder.read(&path, FIGURES_BYTES_MOST),
    };
    Ok(PyBytes::new(py, &py.detach(read)?))
}

/// What is in `path`, a folder in the folder `root`, by number: paths, and whether each is a folder.
#[pyfunction]
pub fn list_of_run(root: &Bound<'_, PyAny>, path: &Bound<'_, PyAny>) -> PyResult<Vec<(PathBuf, bool)>> {
    let folder = RunFolder::new(argument::path("root", root)?);
    let path = argument::path("path", path)?;
    let items = root.py().detach(|| folder.list(&path))?;
    Ok(items.into_iter().map(|Item { path, is_folder, .. }| (path, is_folder)).collect())
}

/// A TOML document as JSON. `tomllib` takes a minute for 80 kB that are made to delay it.
#[pyfunction]
pub fn toml_as_json(py: Python<'_>, text: &str) -> PyResult<String> {
    let json = |table: toml::Table| serde_json::to_string(&table).map_err(|error| error.to_string());
    let written = py.detach(|| text.parse().map_err(|error: toml::de::Error| error.to_string()).and_then(json));
    written.map_err(PyValueError::new_err)
}
