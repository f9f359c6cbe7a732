//! The policy of an ego as a driver of traffic.

use ccdiff_bridge::errors::{from_sim, py};
use ccdiff_bridge::{contained, policy_capsule};
use ccdiff_sim::options;
use ccdiff_sim::planner::{EgoParts, Egos};
use numpy::{PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyCapsule;
use std::collections::BTreeMap;

/// Adds the function of this file to the module.
pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(egos_policy, module)?)
}

/// A policy of worlds: `observation` and `action` are configurations as JSON, `tensors` weights by name.
#[pyfunction]
fn egos_policy<'py>(
    py: Python<'py>,
    observation: &str,
    action: &str,
    decision_steps: usize,
    tensors: BTreeMap<String, PyReadonlyArrayDyn<'_, f32>>,
) -> PyResult<Bound<'py, PyCapsule>> {
    let whole = |(name, array): (String, PyReadonlyArrayDyn<'_, f32>)| {
        let numbers = array.as_slice().map_err(|e| py::ConfigError::new_err(format!("{name}: {e}")))?;
        Ok((name, (array.shape().to_vec(), numbers.to_vec())))
    };
    let parts = EgoParts {
        observation: options::read("observation", observation).map_err(from_sim)?,
        action: options::read("action", action).map_err(from_sim)?,
        decision_steps,
        tensors: tensors.into_iter().map(whole).collect::<PyResult<_>>()?,
    };
    policy_capsule(py, contained(Box::new(Egos::new(parts).map_err(from_sim)?)))
}
