use proto::printable::printable;
use pyo3::PyErr;
use pyo3::exceptions::PyValueError;

/// What Python gets of an error that the user can mend.
pub fn value_error(error: impl std::error::Error) -> PyErr {
    let mut text = error.to_string();
    let mut source = error.source();
    while let Some(cause) = source {
        text = format!("{text}: {cause}");
        source = cause.source();
    }
    // It may quote a file that is somebody else's.
    PyValueError::new_err(printable(&text).into_owned())
}
