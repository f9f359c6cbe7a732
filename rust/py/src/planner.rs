//! Bindings of the package's planners.

use crate::enter::enter;
use ccdiff_bridge::errors::{from_sim, py::ShapeError, py::UnknownNameError};
use ccdiff_sim::planner::{Planner, PlannerKind};
use ccdiff_sim::world::VecWorld;
use numpy::{PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;

/// Adds the class of this file to the module.
pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PyPlanner>()
}

/// A planner of the package, `pdm` or `idm`: drives the first slots of worlds.
#[pyclass(name = "Planner", module = "ccdiff_env._native")]
pub(crate) struct PyPlanner {
    planner: Planner,
}

#[pymethods]
impl PyPlanner {
    #[new]
    fn new(kind: &str) -> PyResult<Self> {
        let kind = match kind {
            "pdm" => PlannerKind::Pdm,
            "idm" => PlannerKind::Idm,
            _ => return Err(UnknownNameError::new_err(format!("no planner {kind:?}, there are pdm, idm"))),
        };
        Ok(Self { planner: Planner::new(kind) })
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
            for i in (0..e).filter(|i| active.as_ref().is_none_or(|a| a[*i])) {
                let action = self.planner.act(world, i).map_err(from_sim)?;
                flat[i * w..(i + 1) * w].copy_from_slice(&action[..w]);
            }
            Ok(())
        })?;
        PyArray1::from_vec(py, flat).reshape([e, w])
    }
}
