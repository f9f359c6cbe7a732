//! Entering Rust: texts, flags of numpy; with an object that owns threads: fork check, GIL release, panics as exceptions.

use ccdiff_bridge::errors::py;
use numpy::{PyReadonlyArray, PyReadonlyArrayDyn};
use pyo3::Borrowed;
use pyo3::exceptions::{PyRuntimeError, PyUnicodeError};
use pyo3::prelude::*;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Refuses a forked child of the process in which an object was made: its copies of the worker threads do not run.
pub(crate) fn check_process(home: u32) -> PyResult<()> {
    let here = std::process::id();
    if here == home {
        return Ok(());
    }
    Err(py::ForkError::new_err(format!(
        "made in process {home}, used in its forked child {here}: worker threads do not survive a fork. Use the \
         \"spawn\" start method, or one vector environment instead of one environment per process"
    )))
}

/// Flags of an array in its order of rows: any byte but 0 is true. (A `bool` of Rust may be 0 or 1 only, an array of
/// numpy holds what its maker put there.)
pub(crate) fn flags<D: ndarray::Dimension>(array: &PyReadonlyArray<'_, bool, D>) -> PyResult<Vec<bool>> {
    let bytes: PyReadonlyArrayDyn<'_, u8> = array.as_any().call_method1("view", ("uint8",))?.extract()?;
    Ok(bytes.as_array().iter().map(|byte| *byte != 0).collect())
}

/// Runs a call without the GIL; a panic becomes a `RuntimeError`.
pub(crate) fn enter<T, F>(python: Python<'_>, call: F) -> PyResult<T>
where
    T: Send,
    F: FnOnce() -> PyResult<T> + Send,
{
    python.detach(|| catch_unwind(AssertUnwindSafe(call))).unwrap_or_else(|cause| {
        let text = cause.downcast_ref::<&str>().map(ToString::to_string);
        let text = text.or_else(|| cause.downcast_ref::<String>().cloned()).unwrap_or_default();
        Err(PyRuntimeError::new_err(format!("internal fault, please report it: {text}")))
    })
}

/// A text of a scene. `SceneError` where a `str` of Python contains an unpaired surrogate, which no file can hold.
#[derive(Default)]
pub(crate) struct Text(pub(crate) String);

impl<'a, 'py> FromPyObject<'a, 'py> for Text {
    type Error = PyErr;

    fn extract(value: Borrowed<'a, 'py, PyAny>) -> PyResult<Self> {
        value.extract().map(Self).map_err(|error: PyErr| {
            if error.is_instance_of::<PyUnicodeError>(value.py()) {
                let shown = value.repr().map_or_else(|_| String::new(), |r| r.to_string_lossy().into_owned());
                py::SceneError::new_err(format!("text {shown} holds an unpaired surrogate, expected Unicode"))
            } else {
                error
            }
        })
    }
}
