//! What worlds are configured with and report, as JSON that Python reads names, units and meanings from.

use crate::drivers;
use crate::python_driver::PythonOptions;
use ccdiff_bridge::errors::{from_sim, py};
use ccdiff_nets::traffic::egos::EgosConfig;
use ccdiff_nets::traffic::swift::{EGO, NEIGHBOURS, OTHER, OWN, PLACES, SPACING_M};
use ccdiff_nets::traffic::way_out;
use ccdiff_sim::drivers::{KINDS, PLAN_FIELDS};
use ccdiff_sim::events::limits;
use ccdiff_sim::observe::{BEV_CHANNELS, Layout, ObservationConfig, all_columns};
use ccdiff_sim::options::{Table, check_table};
use ccdiff_sim::world::{CANDIDATE_BOUND, CANDIDATE_FEATURES, COLUMNS, METRICS, TABLES};
use pyo3::prelude::*;

/// A value as JSON.
pub(crate) fn to_json<T: serde::Serialize>(value: &T) -> PyResult<String> {
    serde_json::to_string(value).map_err(|e| py::ConfigError::new_err(e.to_string()))
}

/// A schema as JSON, by its name: rows have name, unit and meaning.
#[pyfunction]
pub(crate) fn schema(name: &str) -> PyResult<String> {
    match name {
        "config_tables" => to_json(&tables().collect::<Vec<_>>()),
        // info columns of a step, metrics of an episode, fields of a plan's record
        "columns" => to_json(&COLUMNS),
        "metrics" => to_json(&METRICS),
        "plan_fields" => to_json(&PLAN_FIELDS),
        // the default layout, all columns by entry and the channels of rasters
        "observation" => {
            let layout = Layout::new(&ObservationConfig::default()).map_err(from_sim)?;
            to_json(&(layout, all_columns(), BEV_CHANNELS))
        }
        // the bound of all features of candidates, and the features
        "candidates" => to_json(&(CANDIDATE_BOUND, CANDIDATE_FEATURES)),
        // limits of nuPlan's comfort, and its least time to contact
        "limits" => to_json(&serde_json::json!({
            "acceleration": limits::ACCELERATION_MPS2,
            "lateral_acceleration": limits::LATERAL_ACCELERATION_MPS2,
            "jerk": limits::JERK_MPS3,
            "longitudinal_jerk": limits::LONGITUDINAL_JERK_MPS3,
            "yaw_rate": limits::YAW_RATE_RADPS,
            "yaw_acceleration": limits::YAW_ACCELERATION_RADPS2,
            "ttc_s": limits::TTC_S,
        })),
        // accelerations and offsets of the steady plans that are ways out
        "steady_plans" => to_json(&(way_out::ACCELERATIONS_MPS2, way_out::OFFSETS_M)),
        // numbers of a row of swift traffic: own, of the ego, other agents, of each; how far ahead places are
        "swift_row" => to_json(&(OWN, EGO, NEIGHBOURS, OTHER, PLACES.map(|k| k as f32 * SPACING_M))),
        _ => Err(py::UnknownNameError::new_err(format!("no schema {name:?}"))),
    }
}

fn tables() -> impl Iterator<Item = &'static Table> {
    let of_kinds = KINDS.iter().filter_map(|kind| kind.options);
    let more = of_kinds.filter(|table| TABLES.iter().all(|known| known.name != table.name));
    TABLES.iter().copied().chain(more).chain([&PythonOptions::TABLE, &EgosConfig::TABLE])
}

/// Checks options that are used in Python alone, as JSON, against the table of this name; `path` is where they stand.
#[pyfunction]
pub(crate) fn check_options(table: &str, path: &str, options: &str) -> PyResult<()> {
    let of_drivers = drivers::kinds().filter_map(|kind| kind.options);
    let known = tables().chain(of_drivers).find(|t| t.name == table);
    let known = known.ok_or_else(|| py::ConfigError::new_err(format!("no table of options {table:?}")))?;
    check_table(known, path, options).map_err(from_sim)
}
