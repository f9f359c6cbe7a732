//! Networks as both modules hand them to Python: plans of scenes, and drivers of worlds.

use crate::contained;
use crate::errors::{from_model, from_sim, from_weights, py};
use crate::handed::{BoxedDriver, Handed};
use ccdiff_nets::guidance::GuidanceReport;
use ccdiff_nets::inputs::features::vehicles;
use ccdiff_nets::networks::logged::Logged;
use ccdiff_nets::networks::trajectory_model::{Plan, PlanOptions, TrajectoryModel};
use ccdiff_nets::sampling::sampler::SampleOptions;
use ccdiff_nets::traffic::{CcdiffConfig, PlannedTraffic};
use ccdiff_sim::options::read;
use ccdiff_sim::scene::Scene;
use numpy::{IntoPyArray, PyArray1, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A driver of worlds that is asked for: its name and kind, options as JSON, step of the worlds, their scenes.
pub struct AskedDriver<'a> {
    /// Name in the batch.
    pub name: &'a str,
    /// Kind of the network.
    pub kind: &'a str,
    /// A `CcdiffConfig` as JSON.
    pub options: &'a str,
    /// Step of the worlds, seconds.
    pub dt_s: f32,
    /// Their scenes.
    pub scenes: &'a [Arc<Scene>],
}

/// Where the options of a driver stand, as the user has written it.
pub fn path_of(name: &str, kind: &str) -> String {
    if name == kind { kind.to_owned() } else { format!("named_drivers.{name}.{kind}") }
}

impl AskedDriver<'_> {
    /// The driver, of a network that `load` makes.
    ///
    /// # Errors
    /// What options, weights and scenes do not fit.
    pub fn driver(
        self,
        py: Python<'_>,
        load: impl FnOnce(CcdiffConfig) -> ccdiff_nets::Result<PlannedTraffic> + Send,
    ) -> PyResult<BoxedDriver> {
        let Self { name, kind, options, dt_s, scenes } = self;
        let config: CcdiffConfig = read(&path_of(name, kind), options).map_err(from_sim)?;
        let driver = py.detach(|| {
            let driver = load(config)?;
            driver.check(dt_s, scenes).map(|()| driver)
        });
        let driver = driver.map_err(from_weights)?;
        if driver.kind() != kind {
            let message = format!(
                "config: named_drivers: {name}: weights of {:?}, expected those of {kind:?}",
                driver.kind()
            );
            return Err(py::ConfigError::new_err(message));
        }
        Ok(contained(Box::new(driver)))
    }
}

/// A loaded network that plans for scenes.
#[pyclass(frozen, name = "TrajectoryModel", module = "ccdiff_env._native")]
#[derive(Debug)]
pub struct PyTrajectoryModel(Mutex<TrajectoryModel>);

impl PyTrajectoryModel {
    /// A network of whichever module.
    pub fn new(model: TrajectoryModel) -> Self {
        Self(Mutex::new(model))
    }

    fn lock(&self) -> MutexGuard<'_, TrajectoryModel> {
        // a failed call leaves weights that are whole, so a poisoned lock is still good
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[pymethods]
impl PyTrajectoryModel {
    /// The file's header as JSON.
    #[getter]
    fn header(&self) -> String {
        self.lock().header().to_string()
    }

    #[getter]
    fn num_parameters(&self) -> usize {
        self.lock().num_parameters()
    }

    /// Plans from logged histories: one dictionary per (scene, step). `guidance` is a `GuidanceConfig` as JSON; `guided` lists
    /// agents of each scene.
    #[pyo3(signature = (scenes, steps, seeds, *, solver_steps, num_samples, guidance_weight, guidance, guided, attention,
        follow_route))]
    fn plan_scenes<'py>(
        &self,
        py: Python<'py>,
        scenes: Vec<Handed>,
        steps: Vec<usize>,
        seeds: Vec<u64>,
        solver_steps: Option<usize>,
        num_samples: usize,
        guidance_weight: f64,
        guidance: Option<&str>,
        guided: Option<Vec<Vec<usize>>>,
        attention: bool,
        follow_route: bool,
    ) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let scenes: Vec<_> = scenes.into_iter().map(|s| s.0).collect();
        let lists = guided.as_ref().map_or(scenes.len(), Vec::len);
        if [steps.len(), seeds.len(), lists].iter().any(|got| *got != scenes.len()) {
            let got = format!("{} steps, {} seeds, {lists} lists of agents", steps.len(), seeds.len());
            return Err(py::ShapeError::new_err(format!("{got} for {} scenes", scenes.len())));
        }
        let options = PlanOptions {
            sampling: SampleOptions {
                solver_steps,
                num_samples,
                guidance_weight,
                ..SampleOptions::default()
            },
            guidance: guidance.map(|text| read("guidance", text)).transpose().map_err(from_sim)?,
            attention,
            gradient_statistics: false,
        };
        let logged = Logged { scenes: &scenes, steps: &steps, seeds: &seeds, guided, follow_route };
        let plans = py.detach(|| logged.plans(&mut self.lock(), &options));
        let plans =
            plans.map_err(|e| crate::cost::raised(&e.to_string()).unwrap_or_else(|| from_model(e)))?;
        scenes.iter().zip(plans).map(|(scene, plan)| plan_dict(py, scene, plan)).collect()
    }
}

/// `agents` [M] (indices in the scene), `actions` [N, M, T, 2], `states` [N, M, T, 6], `poses` [M, 3], `graph` and `ttc`
/// [M, M], `attention` [M, M] or `None`, `selected_sample` [M], `guidance` or `None`.
fn plan_dict<'py>(py: Python<'py>, scene: &Scene, plan: Plan) -> PyResult<Bound<'py, PyDict>> {
    let (n, m) = (plan.num_samples, plan.agents.len());
    let list = vehicles(scene);
    let agents: Vec<i64> = plan.agents.iter().map(|a| list[*a] as i64).collect();
    let steps = plan.actions.len() / (n * m * 2).max(1);
    let poses: Vec<f32> =
        plan.features.poses.iter().flat_map(|p| [p.position.x, p.position.y, p.heading_rad]).collect();
    let dict = PyDict::new(py);
    let attention = plan.attention_matrix().map(|a| a.into_pyarray(py).reshape([m, m])).transpose()?;
    dict.set_item("attention", attention)?;
    let selected: Vec<i64> = plan.selected_sample().iter().map(|c| *c as i64).collect();
    dict.set_item("selected_sample", PyArray1::from_vec(py, selected))?;
    dict.set_item("guidance", plan.guidance.map(|g| guidance_dict(py, n, m, g)).transpose()?)?;
    dict.set_item("agents", PyArray1::from_vec(py, agents))?;
    dict.set_item("actions", plan.actions.into_pyarray(py).reshape([n, m, steps, 2])?)?;
    dict.set_item("states", plan.states.into_pyarray(py).reshape([n, m, steps, 6])?)?;
    dict.set_item("poses", poses.into_pyarray(py).reshape([m, 3])?)?;
    dict.set_item("graph", plan.features.graph.as_slice().to_vec().into_pyarray(py).reshape([m, m])?)?;
    dict.set_item("ttc", plan.features.ttc_s.into_pyarray(py).reshape([m, m])?)?;
    Ok(dict)
}

/// `losses` [J, N, M], `moved_m` [M].
fn guidance_dict(
    py: Python<'_>,
    num_samples: usize,
    num_agents: usize,
    report: GuidanceReport,
) -> PyResult<Bound<'_, PyDict>> {
    let dict = PyDict::new(py);
    let objectives = report.losses.len() / (num_samples * num_agents).max(1);
    let losses = report.losses.into_pyarray(py).reshape([objectives, num_samples, num_agents])?;
    dict.set_item("losses", losses)?;
    dict.set_item("moved_m", report.moved_m.into_pyarray(py))?;
    Ok(dict)
}
