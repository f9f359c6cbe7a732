//! The network of an ego, by itself and as a driver of traffic.

use crate::enter::enter;
use ccdiff_bridge::errors::{from_sim, py};
use ccdiff_bridge::{contained, driver_capsule};
use ccdiff_sim::observe::Layout;
use ccdiff_sim::options;
use ccdiff_sim::planner::{EgoParts, Egos, NetworkOfEgo, Tensors};
use ccdiff_sim::world::{ActionConfig, ActionDecoder};
use numpy::{
    PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2, PyReadonlyArrayDyn, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::PyCapsule;
use std::collections::BTreeMap;

/// Weights by name.
type Arrays<'py> = BTreeMap<String, PyReadonlyArrayDyn<'py, f32>>;

fn taken(arrays: Arrays<'_>) -> PyResult<Tensors> {
    let whole = |(name, array): (String, PyReadonlyArrayDyn<'_, f32>)| {
        let numbers = array.as_slice().map_err(|e| py::ConfigError::new_err(format!("{name}: {e}")))?;
        Ok((name, (array.shape().to_vec(), numbers.to_vec())))
    };
    arrays.into_iter().map(whole).collect()
}

/// Traffic that a trained ego drives: `observation` and `action` are configurations as JSON, `tensors` weights by name.
#[pyfunction]
pub(crate) fn egos_driver<'py>(
    py: Python<'py>,
    observation: &str,
    action: &str,
    decision_steps: usize,
    tensors: Arrays<'_>,
) -> PyResult<Bound<'py, PyCapsule>> {
    let parts = EgoParts {
        observation: options::read("observation", observation).map_err(from_sim)?,
        action: options::read("action", action).map_err(from_sim)?,
        decision_steps,
        tensors: taken(tensors)?,
    };
    driver_capsule(py, contained(Box::new(Egos::new(parts).map_err(from_sim)?)))
}

/// The network of an ego: actions for observations. Configurations and weights as in `egos_driver`.
#[pyclass(module = "ccdiff_env._native")]
pub(crate) struct EgoNetwork(NetworkOfEgo);

#[pymethods]
impl EgoNetwork {
    #[new]
    fn new(observation: &str, action: &str, tensors: Arrays<'_>) -> PyResult<Self> {
        let layout = Layout::new(&options::read("observation", observation).map_err(from_sim)?);
        let action: ActionConfig = options::read("action", action).map_err(from_sim)?;
        let width = ActionDecoder::new(&action).width();
        let damaged = |e: ccdiff_sim::SimError| {
            py::DatasetError::new_err(e.to_string().trim_start_matches("config: policy: ").to_owned())
        };
        let made = NetworkOfEgo::new(&layout.map_err(from_sim)?, width, taken(tensors)?);
        Ok(Self(made.map_err(damaged)?))
    }

    /// Actions [N, W] in [-1, 1] for observations [N, D].
    fn act<'py>(
        &mut self,
        py: Python<'py>,
        obs: PyReadonlyArray2<'_, f32>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let [size, width] = self.0.sizes();
        let (rows, found) = (obs.as_array(), obs.shape());
        if found[1] != size {
            let message = format!("policy: obs has shape {found:?}, expected [N, {size}]");
            return Err(py::ShapeError::new_err(message));
        }
        let (num_rows, numbers) = (found[0], rows.iter().copied().collect::<Vec<f32>>());
        let actions = enter(py, || Ok(numbers.chunks_exact(size).flat_map(|row| self.0.act(row)).collect()))?;
        PyArray1::from_vec(py, actions).reshape([num_rows, width])
    }
}
