//! Bindings of the package's planners.

use crate::enter::enter;
use ccdiff_bridge::errors::{from_sim, py::ShapeError};
use ccdiff_sim::planner::Planner;
use ccdiff_sim::world::VecWorld;
use numpy::{PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;

/// A planner of the package, `pdm` or `idm`: drives the first slots of worlds.
#[pyclass(name = "Planner", module = "ccdiff_env._native")]
pub(crate) struct PyPlanner {
    planner: Planner,
}

#[pymethods]
impl PyPlanner {
    #[new]
    fn new(kind: &str) -> PyResult<Self> {
        Ok(Self { planner: Planner::new(kind).map_err(from_sim)? })
    }
}

impl PyPlanner {
    /// Actions [E, W] of all worlds; zeros in those that are not active.
    pub(crate) fn actions<'py>(
        &mut self,
        py: Python<'py>,
        world: &VecWorld,
        active: Option<Vec<bool>>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let (e, w) = (world.num_worlds(), world.decoder().width());
        if let Some(got) = active.as_ref().map(Vec::len).filter(|got| *got != e) {
            return Err(ShapeError::new_err(format!("active has shape [{got}], expected [{e}]")));
        }
        let mut flat = vec![0.0; e * w];
        enter(py, || {
            let worlds: Vec<usize> = (0..e).filter(|i| active.as_ref().is_none_or(|a| a[*i])).collect();
            let actions = self.planner.act(world, &worlds).map_err(from_sim)?;
            for (i, action) in worlds.into_iter().zip(actions) {
                flat[i * w..(i + 1) * w].copy_from_slice(&action[..w]);
            }
            Ok(())
        })?;
        PyArray1::from_vec(py, flat).reshape([e, w])
    }
}
