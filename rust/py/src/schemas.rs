//! What worlds are configured with and report, as JSON that Python reads names, units and meanings from.

use crate::drivers;
use crate::python_policy::PythonOptions;
use ccdiff_bridge::errors::{from_sim, py};
use ccdiff_sim::observe::{BEV_CHANNELS, Layout, ObservationConfig, all_columns};
use ccdiff_sim::options::{Table, check_table};
use ccdiff_sim::planner::EgosConfig;
use ccdiff_sim::policy::{self, PLAN_FIELDS};
use ccdiff_sim::world::{CANDIDATE_BOUND, CANDIDATE_FEATURES, COLUMNS, METRICS, TABLES, WorldConfig};
use pyo3::prelude::*;

/// Adds the functions of this file to the module.
pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(default_world_config, module)?)?;
    module.add_function(wrap_pyfunction!(config_tables, module)?)?;
    module.add_function(wrap_pyfunction!(check_options, module)?)?;
    module.add_function(wrap_pyfunction!(columns_json, module)?)?;
    module.add_function(wrap_pyfunction!(observation_json, module)?)?;
    module.add_function(wrap_pyfunction!(metrics_json, module)?)?;
    module.add_function(wrap_pyfunction!(plan_fields_json, module)?)?;
    module.add_function(wrap_pyfunction!(candidate_features_json, module)?)
}

/// A value as JSON.
pub(crate) fn to_json<T: serde::Serialize>(value: &T) -> PyResult<String> {
    serde_json::to_string(value).map_err(|e| py::ConfigError::new_err(e.to_string()))
}

/// The tables of the configuration of worlds as JSON: names, defaults, units, ranges, meanings.
#[pyfunction]
fn config_tables() -> PyResult<String> {
    to_json(&tables().collect::<Vec<_>>())
}

fn tables() -> impl Iterator<Item = &'static Table> {
    let of_kinds = policy::KINDS.iter().filter_map(|kind| kind.options);
    let more = of_kinds.filter(|table| TABLES.iter().all(|known| known.name != table.name));
    TABLES.iter().copied().chain(more).chain([&PythonOptions::TABLE, &EgosConfig::TABLE])
}

/// Checks options that are used in Python alone, as JSON, against the table of this name; `path` is where they stand.
#[pyfunction]
fn check_options(table: &str, path: &str, options: &str) -> PyResult<()> {
    let of_drivers = drivers::kinds().filter_map(|kind| kind.options);
    let known = tables().chain(of_drivers).find(|t| t.name == table);
    let known = known.ok_or_else(|| py::ConfigError::new_err(format!("no table of options {table:?}")))?;
    check_table(known, path, options).map_err(from_sim)
}

/// The default configuration as JSON.
#[pyfunction]
fn default_world_config() -> PyResult<String> {
    to_json(&WorldConfig::default())
}

/// the schema of the info columns of a step as JSON: name, unit and meaning of each column.
#[pyfunction]
fn columns_json() -> PyResult<String> {
    to_json(&COLUMNS)
}

/// The default layout of observations, all columns by entry and the channels of rasters, as JSON.
#[pyfunction]
fn observation_json() -> PyResult<String> {
    let layout = Layout::new(&ObservationConfig::default()).map_err(from_sim)?;
    to_json(&(layout, all_columns(), BEV_CHANNELS))
}

/// The schema of the metrics of an episode as JSON.
#[pyfunction]
fn metrics_json() -> PyResult<String> {
    to_json(&METRICS)
}

/// The fields of a plan's record as JSON: name, type, axes and meaning of each, and whether it is always kept.
#[pyfunction]
fn plan_fields_json() -> PyResult<String> {
    to_json(&PLAN_FIELDS)
}

/// The bound of all features of candidates and, of each, name, unit, scale and meaning, as JSON.
#[pyfunction]
fn candidate_features_json() -> PyResult<String> {
    to_json(&(CANDIDATE_BOUND, CANDIDATE_FEATURES))
}
