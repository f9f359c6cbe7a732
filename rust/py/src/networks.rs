//! Networks on the kernels of `ccdiff_nets`: what drives and plans without torch.

use crate::swift;
use ccdiff_bridge::errors::{from_model, py};
use ccdiff_bridge::{AskedDriver, Handed, PyTrajectoryModel};
use ccdiff_nets::compute::weights;
use ccdiff_nets::guidance::GuidanceConfig;
use ccdiff_nets::networks::kinds::{check_cpu, described};
use ccdiff_nets::networks::trajectory_model::TrajectoryModel;
use ccdiff_nets::traffic::PlannedTraffic;
use ccdiff_nets::traffic::swift::SWIFT;
use pyo3::prelude::*;
use pyo3::types::PyCapsule;
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

/// A driver of worlds with this step over these scenes, which plans on this many threads; `options` is a
/// `CcdiffConfig` as JSON.
#[pyfunction]
pub(crate) fn network_driver<'py>(
    py: Python<'py>,
    name: &str,
    kind: &str,
    options: &str,
    weights: PathBuf,
    dt_s: f32,
    num_threads: usize,
    scenes: Vec<Handed>,
) -> PyResult<Bound<'py, PyCapsule>> {
    if kind == SWIFT.name {
        return swift::driver(py, name, options, &weights, dt_s, num_threads);
    }
    let asked = AskedDriver { name, kind, options, dt_s, scenes };
    asked.driver(py, |config| PlannedTraffic::new(config, &weights, num_threads))
}

/// Settings of a guidance preset, as JSON.
#[pyfunction]
pub(crate) fn guidance_preset(name: &str) -> PyResult<String> {
    let preset = GuidanceConfig::preset(name).map_err(from_model)?;
    serde_json::to_string(&preset).map_err(|e| py::ConfigError::new_err(e.to_string()))
}
