//! CCDiff traffic of a batch of worlds, and its plans as arrays.

use crate::errors::py;
use crate::models::from_model;
use ccdiff_models::traffic::{Ccdiff, CcdiffConfig};
use ccdiff_sim::policy::{BackgroundPolicy, Explanation};
use ccdiff_sim::scene::Scene;
use ccdiff_sim::world::{Driver, WorldConfig};
use numpy::{PyArray1, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;
use std::sync::Arc;

/// The policy that plans, where a driver of the configuration asks for it.
pub(crate) fn policy(
    config: &WorldConfig,
    scenes: &[Arc<Scene>],
    weights: Option<PathBuf>,
) -> PyResult<Option<Box<dyn BackgroundPolicy>>> {
    if config.traffic != Driver::Ccdiff && config.driver != Driver::Ccdiff {
        return Ok(None);
    }
    let options = if config.ccdiff.is_null() {
        CcdiffConfig::default()
    } else {
        serde_json::from_value(config.ccdiff.clone())
            .map_err(|e| py::ConfigError::new_err(format!("config: ccdiff: {e}")))?
    };
    let weights = weights.unwrap_or_else(|| PathBuf::from(&options.weights));
    let policy = Ccdiff::new(options, &weights).map_err(from_model)?;
    policy.check(config.dt_s, config.history_steps, scenes).map_err(from_model)?;
    Ok(Some(Box::new(policy)))
}

/// A plan as a dictionary of new arrays: shapes as in [`Explanation`].
pub(crate) fn dict<'py>(py: Python<'py>, plan: &Explanation) -> PyResult<Bound<'py, PyDict>> {
    let (n, m, t) = (plan.num_samples, plan.agents.len(), plan.num_steps);
    let j = plan.objectives.len();
    let indices = |v: &[usize]| PyArray1::from_iter(py, v.iter().map(|i| *i as i64));
    let dict = PyDict::new(py);
    dict.set_item("made_at", plan.made_at)?;
    dict.set_item("agents", indices(&plan.agents))?;
    dict.set_item("executed", PyArray1::from_slice(py, &plan.executed))?;
    dict.set_item("guided", PyArray1::from_slice(py, &plan.guided))?;
    dict.set_item("graph", PyArray1::from_slice(py, &plan.graph).reshape([m, m])?)?;
    dict.set_item("ttc_s", PyArray1::from_slice(py, &plan.ttc_s).reshape([m, m])?)?;
    let attention = if plan.attention.is_empty() {
        None
    } else {
        Some(PyArray1::from_slice(py, &plan.attention).reshape([m, m])?)
    };
    dict.set_item("attention", attention)?;
    dict.set_item("ranking", indices(&plan.ranking))?;
    dict.set_item("samples", PyArray1::from_slice(py, &plan.samples).reshape([n, m, t, 3])?)?;
    dict.set_item("chosen", indices(&plan.chosen))?;
    dict.set_item("objectives", &plan.objectives)?;
    dict.set_item("losses", PyArray1::from_slice(py, &plan.losses).reshape([j, n, m])?)?;
    dict.set_item("realism_cost", PyArray1::from_slice(py, &plan.realism_cost))?;
    let cosine = if plan.gradient_cosine.is_empty() {
        None
    } else {
        Some(PyArray1::from_slice(py, &plan.gradient_cosine).reshape([j, j])?)
    };
    dict.set_item("gradient_cosine", cosine)?;
    for (name, values) in [("realism_cosine", &plan.realism_cosine), ("conflict_share", &plan.conflict_share)]
    {
        dict.set_item(name, (!values.is_empty()).then(|| PyArray1::from_slice(py, values)))?;
    }
    Ok(dict)
}
