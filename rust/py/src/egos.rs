//! The network of an ego, by itself and as a driver of traffic.

use crate::enter::enter;
use ccdiff_bridge::errors::{from_model, from_sim, py};
use ccdiff_bridge::{BoxedDriver, contained};
use ccdiff_nets::ModelError;
use ccdiff_nets::compute::weights::Entry;
use ccdiff_nets::traffic::egos::{EgoParts, Egos, NetworkOfEgo};
use ccdiff_sim::observe::Layout;
use ccdiff_sim::options;
use ccdiff_sim::world::{ActionConfig, ActionDecoder};
use numpy::{
    PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2, PyReadonlyArrayDyn, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use std::collections::BTreeMap;

/// Weights by name.
type Arrays<'py> = BTreeMap<String, PyReadonlyArrayDyn<'py, f32>>;

fn read_arrays(arrays: Arrays<'_>) -> PyResult<BTreeMap<String, Entry>> {
    let whole = |(name, array): (String, PyReadonlyArrayDyn<'_, f32>)| {
        let numbers = array.as_slice().map_err(|e| py::ConfigError::new_err(format!("{name}: {e}")))?;
        Ok((name, (array.shape().to_vec(), numbers.to_vec())))
    };
    arrays.into_iter().map(whole).collect()
}

/// Traffic that a trained ego drives, of its observation and action (configurations as JSON), steps of a decision and weights by name.
pub(crate) fn driver(parts: &Bound<'_, PyAny>) -> PyResult<BoxedDriver> {
    let (observation, action, decision_steps, tensors): (String, String, usize, Arrays<'_>) =
        parts.extract()?;
    let parts = EgoParts {
        observation: options::read("observation", &observation).map_err(from_sim)?,
        action: options::read("action", &action).map_err(from_sim)?,
        decision_steps,
        tensors: read_arrays(tensors)?,
    };
    Ok(contained(Box::new(Egos::new(parts).map_err(misfit)?)))
}

/// The error of weights that do not fit; whoever read their file names it.
fn misfit(error: ModelError) -> PyErr {
    match error {
        ModelError::Checkpoint { entry, got, expected, .. } => {
            py::DatasetError::new_err(format!("{entry} is {got}, expected {expected}"))
        }
        error => from_model(error),
    }
}

/// The network of an ego: actions for observations. Configurations and weights as in [`driver`].
#[pyclass(module = "ccdiff_env._native")]
pub(crate) struct EgoNetwork(NetworkOfEgo);

#[pymethods]
impl EgoNetwork {
    #[new]
    fn new(observation: &str, action: &str, tensors: Arrays<'_>) -> PyResult<Self> {
        let layout = Layout::new(&options::read("observation", observation).map_err(from_sim)?);
        let action: ActionConfig = options::read("action", action).map_err(from_sim)?;
        let width = ActionDecoder::new(&action).width();
        let made = NetworkOfEgo::new(&layout.map_err(from_sim)?, width, read_arrays(tensors)?);
        Ok(Self(made.map_err(misfit)?))
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
