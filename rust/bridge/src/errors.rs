//! From Rust errors to the exception tree of `ccdiff_env.errors`.

use ccdiff_nets::ModelError;
use ccdiff_sim::SimError;
use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;

/// The classes, as Python defines them.
pub mod py {
    #![allow(missing_docs, reason = "documented in ccdiff_env/errors.py")]
    pyo3::import_exception!(ccdiff_env.errors, ActionError);
    pyo3::import_exception!(ccdiff_env.errors, CheckpointError);
    pyo3::import_exception!(ccdiff_env.errors, ConfigError);
    pyo3::import_exception!(ccdiff_env.errors, DatasetError);
    pyo3::import_exception!(ccdiff_env.errors, DatasetNotFoundError);
    pyo3::import_exception!(ccdiff_env.errors, ForkError);
    pyo3::import_exception!(ccdiff_env.errors, PolicyError);
    pyo3::import_exception!(ccdiff_env.errors, ResetNeededError);
    pyo3::import_exception!(ccdiff_env.errors, SceneError);
    pyo3::import_exception!(ccdiff_env.errors, ShapeError);
    pyo3::import_exception!(ccdiff_env.errors, SnapshotError);
    pyo3::import_exception!(ccdiff_env.errors, ThreadError);
    pyo3::import_exception!(ccdiff_env.errors, UnknownNameError);
}

/// The Python exception for a simulator error.
pub fn from_sim(error: SimError) -> PyErr {
    let message = error.to_string();
    match error {
        SimError::Scene { .. } => py::SceneError::new_err(message),
        SimError::Config { .. } => py::ConfigError::new_err(message),
        SimError::Length { .. } => py::ShapeError::new_err(message),
        SimError::Action { .. } => py::ActionError::new_err(message),
        SimError::ResetNeeded { .. } => py::ResetNeededError::new_err(message),
        SimError::Unknown { .. } => py::UnknownNameError::new_err(message),
        SimError::Snapshot(_) => py::SnapshotError::new_err(message),
        SimError::Driver { .. } => driver_failed(message),
    }
}

/// The Python exception for an error of the model crate.
pub fn from_model(error: ModelError) -> PyErr {
    let message = error.to_string();
    match error {
        ModelError::Config { .. } | ModelError::NoSamples { .. } => py::ConfigError::new_err(message),
        ModelError::Shape { .. } => py::ShapeError::new_err(message),
        ModelError::Checkpoint { .. } => py::CheckpointError::new_err(message),
        ModelError::Io { source, path, .. } => PyOSError::new_err((source.raw_os_error(), message, path)),
        ModelError::Sim(source) => from_sim(source),
        ModelError::Diverged { .. } | ModelError::Torch { .. } => driver_failed(message),
    }
}

/// The Python exception for weights that a driver cannot be made of.
pub fn from_weights(error: ModelError) -> PyErr {
    match error {
        ModelError::Io { .. } => py::CheckpointError::new_err(error.to_string()),
        error => from_model(error),
    }
}

/// The Python exception for what libtorch refuses: that of the Python code which torch called (a dispatch mode, a hook),
/// where it raised one.
pub fn driver_failed(message: String) -> PyErr {
    Python::attach(PyErr::take).unwrap_or_else(|| py::PolicyError::new_err(message))
}
