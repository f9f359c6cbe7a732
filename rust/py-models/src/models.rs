//! Bindings of `ccdiff_models`: training runs and models.

use ccdiff_bridge::Handed;
use ccdiff_bridge::errors::{from_sim, policy_failed, py};
use ccdiff_models::config::{ModelConfig, ModelKind};
use ccdiff_models::dataset::{Dataset, vehicles};
use ccdiff_models::features::Window;
use ccdiff_models::guidance::{GuidanceConfig, GuidanceReport, WorldGuidance};
use ccdiff_models::sampler::SampleOptions;
use ccdiff_models::torch_model;
use ccdiff_models::train::{TrainConfig, Trainer, settings_of};
use ccdiff_models::trajectory_model::{Plan, PlanInput, PlanOptions, TrajectoryModel};
use ccdiff_models::{ModelError, device_named};
use ccdiff_sim::geom::Region;
use ccdiff_sim::options::read;
use ccdiff_sim::scene::{LaneIndex, Scene};
use ccdiff_sim::world::Route;
use numpy::{IntoPyArray, PyArray1, PyArrayMethods};
use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Adds the classes and functions of this file to the module.
pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PyTrainer>()?;
    module.add_class::<PyTrajectoryModel>()?;
    module.add_function(wrap_pyfunction!(model_preset, module)?)?;
    module.add_function(wrap_pyfunction!(guidance_preset, module)?)?;
    module.add_function(wrap_pyfunction!(training_settings, module)?)
}

/// The Python exception for an error of the model crate.
pub(crate) fn from_model(error: ModelError) -> PyErr {
    let message = error.to_string();
    match error {
        ModelError::Config { .. } | ModelError::NoSamples { .. } => py::ConfigError::new_err(message),
        ModelError::Shape { .. } => py::ShapeError::new_err(message),
        ModelError::Checkpoint { .. } => py::CheckpointError::new_err(message),
        ModelError::Io { source, path, .. } => PyOSError::new_err((source.raw_os_error(), message, path)),
        ModelError::Sim(source) => from_sim(source),
        _ => policy_failed(message),
    }
}

fn lock<T>(value: &Mutex<T>) -> MutexGuard<'_, T> {
    // a failed call leaves weights that are whole, so a poisoned lock is still good
    value.lock().unwrap_or_else(PoisonError::into_inner)
}

fn parsed<T: serde::de::DeserializeOwned>(what: &str, text: &str) -> PyResult<T> {
    serde_json::from_str(text).map_err(|e| py::ConfigError::new_err(format!("{what}: {e}")))
}

fn to_json<T: serde::Serialize>(value: &T) -> PyResult<String> {
    serde_json::to_string(value).map_err(|e| py::ConfigError::new_err(e.to_string()))
}

fn arcs(scenes: Vec<Handed>) -> Vec<Arc<Scene>> {
    scenes.into_iter().map(|handed| handed.0).collect()
}

/// Model and training settings of a preset for a kind of network, as JSON.
#[pyfunction]
#[pyo3(signature = (name, model="ccdiff"))]
fn model_preset(name: &str, model: &str) -> PyResult<(String, String)> {
    let kind = ModelKind::named(model).map_err(from_model)?;
    let model = ModelConfig::of(kind, name).map_err(from_model)?;
    Ok((to_json(&model)?, to_json(&TrainConfig::preset(name, kind).map_err(from_model)?)?))
}

/// Settings of a guidance preset, as JSON.
#[pyfunction]
fn guidance_preset(name: &str) -> PyResult<String> {
    to_json(&GuidanceConfig::preset(name).map_err(from_model)?)
}

/// Model and training settings of a training state, as JSON.
#[pyfunction]
fn training_settings(py: Python<'_>, path: PathBuf) -> PyResult<(String, String)> {
    let (model, training) = py.detach(|| settings_of(&path)).map_err(from_model)?;
    Ok((to_json(&model)?, to_json(&training)?))
}

/// A training run with its data.
#[pyclass(frozen, name = "Trainer", module = "ccdiff_env._models")]
struct PyTrainer {
    run: Mutex<Trainer>,
    held_out: Option<Dataset>,
}

#[pymethods]
impl PyTrainer {
    /// Fresh weights come from torch's global generator. With `estimate`, the normalisation is taken from the scenes.
    #[new]
    #[pyo3(signature = (scenes, held_out, model, training, *, device, stride, estimate, teacher=None, start=None))]
    fn new(
        py: Python<'_>,
        scenes: Vec<Handed>,
        held_out: Vec<Handed>,
        model: &str,
        training: &str,
        device: &str,
        stride: usize,
        estimate: bool,
        teacher: Option<PathBuf>,
        start: Option<PathBuf>,
    ) -> PyResult<Self> {
        let mut model: ModelConfig = read("model", model).map_err(from_sim)?;
        let training: TrainConfig = read("training", training).map_err(from_sim)?;
        let device = device_named(device).map_err(from_model)?;
        let (scenes, held_out) = (arcs(scenes), arcs(held_out));
        py.detach(move || {
            model = model.validated()?;
            let mut data = Dataset::new(scenes, &model, stride)?;
            if estimate {
                model.normalisation = data.estimate_normalisation(4000, training.seed)?;
                data.set_normalisation(&model.normalisation);
            }
            let held_out = (!held_out.is_empty()).then(|| Dataset::new(held_out, &model, 5)).transpose()?;
            let run = Trainer::new(model, training, data, device)?;
            let run = match &start {
                Some(path) => run.begun_with(path)?,
                None => run,
            };
            let run = match &teacher {
                Some(path) => run.taught_by(path)?,
                None => run,
            };
            Ok(Self { run: Mutex::new(run), held_out })
        })
        .map_err(from_model)
    }

    /// Takes steps; returns their losses.
    fn run(&self, py: Python<'_>, steps: usize) -> PyResult<Vec<f64>> {
        py.detach(|| lock(&self.run).run(steps)).map_err(from_model)
    }

    /// Open-loop errors on the held-out scenes, as a dictionary; `None` where there are none.
    #[pyo3(signature = (count, *, solver_steps, num_samples, guidance_weight))]
    fn validate<'py>(
        &self,
        py: Python<'py>,
        count: usize,
        solver_steps: Option<usize>,
        num_samples: usize,
        guidance_weight: f64,
    ) -> PyResult<Option<Bound<'py, PyDict>>> {
        let Some(held_out) = &self.held_out else { return Ok(None) };
        let options = SampleOptions { solver_steps, num_samples, guidance_weight };
        let v = py.detach(|| lock(&self.run).validate(held_out, count, options)).map_err(from_model)?;
        let dict = PyDict::new(py);
        dict.set_item("min_ade_m", v.min_ade_m)?;
        dict.set_item("min_fde_m", v.min_fde_m)?;
        dict.set_item("ade_m", v.ade_m)?;
        dict.set_item("fde_m", v.fde_m)?;
        dict.set_item("constant_velocity_ade_m", v.constant_velocity_ade_m)?;
        dict.set_item("constant_velocity_fde_m", v.constant_velocity_fde_m)?;
        dict.set_item("num_agents", v.num_agents)?;
        Ok(Some(dict))
    }

    /// Starts the cool-down of the learning rate.
    fn cool_down(&self, steps: u64) {
        lock(&self.run).cool_down(steps);
    }

    /// Steps at which the cool-down starts and ends, once it has begun.
    #[getter]
    fn cooldown(&self) -> Option<(u64, u64)> {
        lock(&self.run).cooldown().map(|c| (c.start, c.start + c.steps))
    }

    /// Writes the state of the run.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        py.detach(|| lock(&self.run).save(&path)).map_err(from_model)
    }

    /// Continues from a state.
    fn resume(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        py.detach(|| lock(&self.run).resume(&path)).map_err(from_model)
    }

    /// Writes the averaged weights; `notes` is a JSON object for the header.
    fn export(&self, py: Python<'_>, path: PathBuf, notes: &str) -> PyResult<()> {
        let notes: serde_json::Value = parsed("notes", notes)?;
        py.detach(|| lock(&self.run).export(&path, &notes)).map_err(from_model)
    }

    #[getter]
    fn step(&self) -> u64 {
        lock(&self.run).step()
    }

    #[getter]
    fn num_parameters(&self) -> usize {
        lock(&self.run).num_parameters()
    }

    #[getter]
    fn num_samples(&self) -> usize {
        lock(&self.run).num_samples()
    }
}

/// A loaded network that plans for scenes.
#[pyclass(frozen, name = "TrajectoryModel", module = "ccdiff_env._models")]
struct PyTrajectoryModel(Mutex<TrajectoryModel>);

#[pymethods]
impl PyTrajectoryModel {
    #[new]
    fn new(py: Python<'_>, path: PathBuf, device: &str) -> PyResult<Self> {
        let device = device_named(device).map_err(from_model)?;
        let model = py.detach(|| torch_model::load(&path, device)).map_err(from_model)?;
        Ok(Self(Mutex::new(model)))
    }

    /// The file's header as JSON.
    #[getter]
    fn header(&self) -> String {
        lock(&self.0).header().to_string()
    }

    #[getter]
    fn num_parameters(&self) -> usize {
        lock(&self.0).num_parameters()
    }

    /// Plans from logged histories: one dictionary per (scene, step). `guidance` is a `GuidanceConfig` as JSON; `guided` and
    /// `collision_targets` list agents of each scene.
    #[pyo3(signature = (scenes, steps, seeds, *, solver_steps, num_samples, guidance_weight, guidance, guided, collision_targets,
        attention, gradient_statistics, follow_route))]
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
        collision_targets: Option<Vec<Vec<usize>>>,
        attention: bool,
        gradient_statistics: bool,
        follow_route: bool,
    ) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let scenes = arcs(scenes);
        let lists = [&guided, &collision_targets].map(|l| l.as_ref().map_or(scenes.len(), Vec::len));
        if [steps.len(), seeds.len(), lists[0], lists[1]].iter().any(|got| *got != scenes.len()) {
            let got = format!("{} steps, {} seeds, {lists:?} lists of agents", steps.len(), seeds.len());
            return Err(py::ShapeError::new_err(format!("{got} for {} scenes", scenes.len())));
        }
        let options = PlanOptions {
            sampling: SampleOptions { solver_steps, num_samples, guidance_weight },
            guidance: guidance.map(|text| read("guidance", text)).transpose().map_err(from_sim)?,
            attention,
            gradient_statistics,
        };
        let logged =
            Logged { scenes: &scenes, steps: &steps, seeds: &seeds, guided, collision_targets, follow_route };
        let plans = py.detach(|| plan_logged(&mut lock(&self.0), &logged, &options));
        let plans = plans.map_err(from_model)?;
        scenes.iter().zip(plans).map(|(scene, plan)| plan_dict(py, scene, plan)).collect()
    }
}

/// What is planned for: scenes at steps, who is guided, and contacts with whom count.
struct Logged<'a> {
    scenes: &'a [Arc<Scene>],
    steps: &'a [usize],
    seeds: &'a [u64],
    guided: Option<Vec<Vec<usize>>>,
    collision_targets: Option<Vec<Vec<usize>>>,
    follow_route: bool,
}

impl Logged<'_> {
    /// Whether each vehicle of each scene is on a list; `None` without lists.
    fn listed(&self, lists: Option<&Vec<Vec<usize>>>) -> Option<Vec<Vec<bool>>> {
        let flags = |(scene, list): (&Arc<Scene>, &Vec<usize>)| {
            vehicles(scene).iter().map(|agent| list.contains(agent)).collect()
        };
        lists.map(|lists| self.scenes.iter().zip(lists).map(flags).collect())
    }
}

fn plan_logged(
    model: &mut TrajectoryModel,
    logged: &Logged<'_>,
    options: &PlanOptions,
) -> ccdiff_models::Result<Vec<Plan>> {
    let (history, points_m) = (model.config().history_steps, model.config().route_points_m.clone());
    if logged.follow_route && points_m.is_empty() {
        let expected = "False: these weights were trained without routes";
        return Err(ModelError::Config { field: "follow_route", got: "True".into(), expected });
    }
    let bitmaps: Vec<_> =
        logged.scenes.iter().map(|s| model.bitmap(s)).collect::<ccdiff_models::Result<_>>()?;
    let windows: Vec<Window> = logged
        .scenes
        .iter()
        .zip(logged.steps)
        .map(|(scene, step)| {
            let agents = vehicles(scene);
            let mut window = Window::from_scene(scene, *step, &agents, history);
            if logged.follow_route {
                let lanes = LaneIndex::new(&scene.map);
                let routes: Vec<Route> =
                    agents.iter().map(|a| Route::new(scene, *a, lanes.as_ref())).collect();
                window.tell_routes(&routes, &points_m);
            }
            window
        })
        .collect();
    let guided = logged.listed(logged.guided.as_ref());
    let collision_targets = logged.listed(logged.collision_targets.as_ref());
    let guides = guided.is_some();
    let roads: Vec<Option<Region>> =
        logged.scenes.iter().map(|s| guides.then(|| Region::new(&s.map.drivable_area)).flatten()).collect();
    let worlds: Vec<PlanInput<'_>> = windows
        .iter()
        .enumerate()
        .map(|(k, window)| PlanInput {
            window,
            bitmap: bitmaps[k].as_ref(),
            seed: logged.seeds[k],
            guide: guided.as_ref().map(|flags| WorldGuidance {
                road: roads[k].as_ref(),
                collision_targets: collision_targets.as_ref().map(|p| p[k].as_slice()),
                ..WorldGuidance::new(&flags[k])
            }),
        })
        .collect();
    model.plan(&worlds, options)
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

/// `losses` [J, N, M], `realism_cost`, `shift_sigmas` [M], and with gradient statistics `alignment`, `gradient_cosine`,
/// `conflict_share` [M], `objective_cosine` [J, J].
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
    dict.set_item("realism_cost", report.realism_cost.into_pyarray(py))?;
    dict.set_item("shift_sigmas", report.shift_sigmas.into_pyarray(py))?;
    if let Some(found) = report.conflict {
        let cosines = found.objective_cosine.into_pyarray(py).reshape([objectives, objectives])?;
        dict.set_item("alignment", found.alignment.into_pyarray(py))?;
        dict.set_item("gradient_cosine", found.cosine.into_pyarray(py))?;
        dict.set_item("conflict_share", found.conflict_share.into_pyarray(py))?;
        dict.set_item("objective_cosine", cosines)?;
    }
    Ok(dict)
}
