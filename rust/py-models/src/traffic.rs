//! Networks as drivers of traffic, made here and handed to the worlds of `_native`.

use ccdiff_bridge::errors::py;
use ccdiff_bridge::{AskedDriver, Handed, driver_capsule};
use ccdiff_models::sampler::SampleOptions;
use ccdiff_models::torch_model::planned_traffic;
use ccdiff_models::traffic::CcdiffConfig;
use ccdiff_models::train::TrainConfig;
use ccdiff_models::{config, guidance};
use ccdiff_sim::options::Table;
use pyo3::prelude::*;
use pyo3::types::PyCapsule;
use std::path::PathBuf;

/// Adds the functions of this file to the module.
pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(config_tables, module)?)?;
    module.add_function(wrap_pyfunction!(network_driver, module)?)
}

/// The tables of networks, of their training, options and guidance as JSON: names, defaults, units, ranges, meanings.
#[pyfunction]
fn config_tables() -> PyResult<String> {
    let own: [&Table; 3] = [&CcdiffConfig::TABLE, &SampleOptions::TABLE, &TrainConfig::TABLE];
    let tables = [&own, guidance::TABLES, config::TABLES].concat();
    serde_json::to_string(&tables).map_err(|e| py::ConfigError::new_err(e.to_string()))
}

/// A driver of worlds with this step over these scenes, on torch, which plans on this many threads; `options` is a
/// `CcdiffConfig` as JSON.
#[pyfunction]
fn network_driver<'py>(
    py: Python<'py>,
    name: &str,
    kind: &str,
    options: &str,
    weights: PathBuf,
    dt_s: f32,
    num_threads: usize,
    scenes: Vec<Handed>,
) -> PyResult<Bound<'py, PyCapsule>> {
    let scenes: Vec<_> = scenes.into_iter().map(|handed| handed.0).collect();
    let asked = AskedDriver { name, kind, options, dt_s, scenes: &scenes };
    driver_capsule(py, asked.driver(py, |config| planned_traffic(config, &weights, num_threads))?)
}
