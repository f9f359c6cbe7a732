//! Networks on the kernels of `ccdiff_nets`: what drives and plans without torch.

use ccdiff_bridge::PyTrajectoryModel;
use ccdiff_bridge::errors::{from_model, py};
use ccdiff_nets::compute::weights;
use ccdiff_nets::guidance::GuidanceConfig;
use ccdiff_nets::networks::kinds::{check_cpu, described};
use ccdiff_nets::networks::trajectory_model::TrajectoryModel;
use ccdiff_nets::traffic::swift::SWIFT;
use pyo3::prelude::*;
use std::path::PathBuf;

/// Whether the network of a weight file has layers that are there on torch alone.
#[pyfunction]
pub(crate) fn needs_torch(py: Python<'_>, path: PathBuf) -> PyResult<bool> {
    let found = py.detach(|| {
        let (header, _) = weights::read(&path)?;
        Ok(header["kind"] != SWIFT.name && check_cpu(&described(&path, &header)?).is_err())
    });
    found.map_err(from_model)
}

/// The network of a weight file.
#[pyfunction]
pub(crate) fn load_network(py: Python<'_>, path: PathBuf) -> PyResult<PyTrajectoryModel> {
    let model = py.detach(|| TrajectoryModel::new(&path, weights::read(&path)?));
    model.map(PyTrajectoryModel::new).map_err(from_model)
}

/// Settings of a guidance preset, as JSON.
#[pyfunction]
pub(crate) fn guidance_preset(name: &str) -> PyResult<String> {
    let preset = GuidanceConfig::preset(name).map_err(from_model)?;
    serde_json::to_string(&preset).map_err(|e| py::ConfigError::new_err(e.to_string()))
}
