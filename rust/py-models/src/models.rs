//! Bindings of `ccdiff_models`: training runs, networks on torch.

use ccdiff_bridge::errors::{from_model, from_sim, py};
use ccdiff_bridge::{Handed, PyTrajectoryModel};
use ccdiff_models::config::ModelConfig;
use ccdiff_models::dataset::Dataset;
use ccdiff_models::sampler::SampleOptions;
use ccdiff_models::train::{ERRORS, TrainConfig, Trainer, settings_of};
use ccdiff_models::{device_named, torch_model};
use ccdiff_sim::options::read;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Adds the classes and functions of this file to the module.
pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PyTrainer>()?;
    module.add_function(wrap_pyfunction!(model_preset, module)?)?;
    module.add_function(wrap_pyfunction!(load_network, module)?)?;
    module.add_function(wrap_pyfunction!(training_settings, module)?)
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

/// Model and training settings of a preset for a kind of network, as JSON.
#[pyfunction]
#[pyo3(signature = (name, model="ccdiff"))]
fn model_preset(name: &str, model: &str) -> PyResult<(String, String)> {
    let training = TrainConfig::of(model, name).map_err(from_model)?;
    Ok((to_json(&ModelConfig::of(model, name).map_err(from_model)?)?, to_json(&training)?))
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
        let [scenes, held_out] =
            [scenes, held_out].map(|list| list.into_iter().map(|s| s.0).collect::<Vec<_>>());
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
        let options =
            SampleOptions { solver_steps, num_samples, guidance_weight, ..SampleOptions::default() };
        let v = py.detach(|| lock(&self.run).validate(held_out, count, options)).map_err(from_model)?;
        let dict = PyDict::new(py);
        for (name, error_m) in ERRORS.into_iter().zip(v.errors_m) {
            dict.set_item(name, error_m)?;
        }
        dict.set_item("num_agents", v.num_agents)?;
        if let Some([told, untold]) = v.nats {
            dict.set_item("nats", told)?;
            dict.set_item("nats_untold", untold)?;
        }
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

/// A network on torch, of a weight file.
#[pyfunction]
fn load_network(py: Python<'_>, path: PathBuf, device: &str) -> PyResult<PyTrajectoryModel> {
    let device = device_named(device).map_err(from_model)?;
    let model = py.detach(|| torch_model::load(&path, device)).map_err(from_model)?;
    Ok(PyTrajectoryModel::new(model))
}
