//! Plans of a world as arrays.

use ccdiff_sim::policy::PlanRecord;
use numpy::{PyArray1, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// A plan as a dictionary of new arrays: shapes as in [`PlanRecord`].
pub(crate) fn dict<'py>(py: Python<'py>, plan: &PlanRecord) -> PyResult<Bound<'py, PyDict>> {
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
    dict.set_item("shift_sigmas", PyArray1::from_slice(py, &plan.shift_sigmas))?;
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
