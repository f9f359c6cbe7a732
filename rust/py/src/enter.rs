//! Entering Rust: texts, flags of numpy; with an object that owns threads: fork check, GIL release, panics as exceptions.

use ccdiff_bridge::errors::py;
use numpy::{Element, PyReadonlyArray, PyReadonlyArrayDyn};
use pyo3::Borrowed;
use pyo3::exceptions::{PyOverflowError, PyRuntimeError, PyTypeError, PyUnicodeError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
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

/// A value in words: `a list`, or the type and shape of an array.
fn form(value: &Bound<'_, PyAny>) -> String {
    let of = |name| value.getattr(name).and_then(|v| v.str()).map(|text| text.to_string());
    let array = || Ok::<_, PyErr>(format!("{} {}", of("dtype")?, of("shape")?));
    array().or_else(|_| Ok::<_, PyErr>(value.get_type().name()?.to_string())).unwrap_or_default()
}

/// An array. `ShapeError` where it is of another type or number of axes, or has a mask of numpy.
pub(crate) fn array<'py, T: Element, D: ndarray::Dimension>(
    value: &Bound<'py, PyAny>,
    what: &str,
    expected: &str,
) -> PyResult<PyReadonlyArray<'py, T, D>> {
    if value.hasattr("mask")? {
        return Err(py::ShapeError::new_err(format!("{what} has a mask, expected a {expected} without one")));
    }
    value
        .extract()
        .map_err(|_| py::ShapeError::new_err(format!("{what} is {}, expected a {expected}", form(value))))
}

/// An array in double precision, and whether it was given in single. `ShapeError` as of [`array`].
pub(crate) fn doubles<D: ndarray::Dimension>(
    value: &Bound<'_, PyAny>,
    what: &str,
    shape: &str,
) -> PyResult<(ndarray::Array<f64, D>, bool)> {
    let expected = format!("float32 or float64 array of shape {shape}");
    if let Ok(double) = array::<f64, D>(value, what, &expected) {
        return Ok((double.as_array().to_owned(), false));
    }
    let single = array::<f32, D>(value, what, &expected)?;
    Ok((single.as_array().mapv(f64::from), true))
}

/// A part of a dictionary. `DatasetError` where it is of another type.
pub(crate) fn part<'a, 'py, T>(value: &'a Bound<'py, PyAny>, what: &str, expected: &str) -> PyResult<T>
where
    T: FromPyObject<'a, 'py>,
{
    value.extract().map_err(|error: T::Error| {
        let (error, py) = (error.into(), value.py());
        if !error.is_instance_of::<PyTypeError>(py) && !error.is_instance_of::<PyOverflowError>(py) {
            return error;
        }
        let shown = value.repr().map_or_else(|_| form(value), |r| r.to_string_lossy().into_owned());
        let shown = if shown.len() > 80 || shown.contains('\n') { form(value) } else { shown };
        py::DatasetError::new_err(format!("{what} is {shown}, expected {expected}"))
    })
}

/// A dictionary, all keys of which are known. `UnknownNameError` for others.
pub(crate) fn fields<'py>(
    value: &Bound<'py, PyAny>,
    what: &str,
    known: &[&str],
) -> PyResult<Bound<'py, PyDict>> {
    let dict: Bound<'py, PyDict> = part(value, what, "a dictionary")?;
    for key in dict.keys() {
        let Text(key) = part(&key, &format!("a key of {what}"), "a text")?;
        if !known.contains(&key.as_str()) {
            let errors = value.py().import("ccdiff_env.errors")?;
            let error = errors.call_method1("unknown", (format!("entry of {what}"), key, known))?;
            return Err(py::UnknownNameError::new_err(error.str()?.to_string()));
        }
    }
    Ok(dict)
}

/// Runs a call without the GIL; a panic becomes a `RuntimeError`.
pub(crate) fn enter<T, F>(python: Python<'_>, call: F) -> PyResult<T>
where
    T: Send,
    F: FnOnce() -> PyResult<T> + Send,
{
    python
        .detach(|| catch_unwind(AssertUnwindSafe(call)))
        .unwrap_or_else(|cause| Err(PyRuntimeError::new_err(ccdiff_bridge::fault(cause))))
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
