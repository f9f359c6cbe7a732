//! The kinds of drivers that there are, and the policies of a batch of worlds: the one place that names them.

use crate::errors::{from_sim, py};
use crate::models::from_model;
use crate::python_policy::PythonPolicy;
use ccdiff_models::ModelKind;
use ccdiff_models::traffic::{CcdiffConfig, PlannedTraffic};
use ccdiff_render::Driver;
use ccdiff_sim::SimError;
use ccdiff_sim::policy::{Idm, TrafficPolicy};
use ccdiff_sim::scene::Scene;
use ccdiff_sim::world::{IdmConfig, WorldConfig};
use pyo3::prelude::*;
use serde::de::DeserializeOwned;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

/// What a policy is made from.
struct Recipe<'a> {
    /// Name in the batch.
    name: &'a str,
    /// Kind of policy.
    kind: &'a str,
    /// Options as JSON.
    options: &'a Value,
    /// Weight file, where Python found one.
    weights: Option<&'a PathBuf>,
    /// The object behind a Python model.
    model: Option<&'a Py<PyAny>>,
    world: &'a WorldConfig,
    scenes: &'a [Arc<Scene>],
}

type Make = fn(&Recipe<'_>) -> PyResult<Box<dyn TrafficPolicy>>;

/// A kind of policy that takes options of its own.
struct Kind {
    /// Name in configurations.
    name: &'static str,
    /// Name in reports.
    title: &'static str,
    /// Whose colour it has in pictures.
    drawn: Driver,
    make: Make,
}

const fn kind(name: &'static str, title: &'static str, drawn: Driver, make: Make) -> Kind {
    Kind { name, title, drawn, make }
}

/// The kinds. A new one is a line here; `replay` and `constant_velocity` have no options and are always there.
const KINDS: [Kind; 10] = [
    kind("idm", "IDM", Driver::Idm, idm),
    kind("python", "Python model", Driver::Other, python),
    kind("ccdiff", "CCDiff", Driver::Ccdiff, network),
    kind("simnet", "SimNet", Driver::Ccdiff, network),
    kind("trafficsim", "TrafficSim", Driver::Ccdiff, network),
    kind("trafficsim_port", "TrafficSim (port)", Driver::Ccdiff, network),
    kind("strive", "STRIVE", Driver::Ccdiff, network),
    kind("bits", "BITS", Driver::Ccdiff, network),
    kind("ctg", "CTG", Driver::Ccdiff, network),
    kind("ctgpp", "CTG++", Driver::Ccdiff, network),
];

/// Adds the functions of this file to the module.
pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(drivers, module)?)
}

/// How pictures show a kind of driver.
pub(crate) fn drawn(kind: &str) -> Driver {
    let pictured = Driver::ALL.into_iter().find(|d| d.name() == kind);
    let like = KINDS.iter().find(|k| k.name == kind).map(|k| k.drawn);
    pictured.or(like).unwrap_or(Driver::Other)
}

/// Name, title, colour and number in pictures of everybody who may move an agent: those that pictures tell apart, in
/// the order of their numbers, then the kinds that look like one of them.
#[pyfunction]
fn drivers() -> Vec<(&'static str, &'static str, (u8, u8, u8), u8)> {
    let row = |name, title, d: Driver| (name, title, (d.colour().0, d.colour().1, d.colour().2), d as u8);
    let pictured = Driver::ALL.iter().map(|d| row(d.name(), d.title(), *d));
    let others = KINDS.iter().filter(|k| k.drawn.name() != k.name);
    pictured.chain(others.map(|k| row(k.name, k.title, k.drawn))).collect()
}

fn idm(recipe: &Recipe<'_>) -> PyResult<Box<dyn TrafficPolicy>> {
    let config: IdmConfig = recipe.options()?;
    if let Some((field, got, expected)) = config.first_fault() {
        let error = SimError::Config { field, got: got.to_string(), expected: expected.into() };
        return Err(from_sim(error));
    }
    Ok(Box::new(Idm { config }))
}

/// Traffic of a model of the user's own.
fn python(recipe: &Recipe<'_>) -> PyResult<Box<dyn TrafficPolicy>> {
    let model = recipe.model.ok_or_else(|| {
        let message = format!("config: policies: {}: no Python object was handed over", recipe.name);
        py::ConfigError::new_err(message)
    })?;
    let model = Python::attach(|py| model.clone_ref(py));
    Ok(Box::new(PythonPolicy::new(recipe.name, recipe.options()?, model)))
}

/// Traffic of a planning network, whose weights say which one it is.
fn network(recipe: &Recipe<'_>) -> PyResult<Box<dyn TrafficPolicy>> {
    let config: CcdiffConfig = recipe.options()?;
    let weights = recipe.weights.cloned().unwrap_or_else(|| PathBuf::from(&config.weights));
    let policy = PlannedTraffic::new(config, &weights).map_err(from_model)?;
    if policy.kind() != recipe.kind {
        return Err(py::ConfigError::new_err(format!(
            "config: policies: {}: weights of {:?}, expected those of {:?}",
            recipe.name,
            policy.kind(),
            recipe.kind
        )));
    }
    policy.check(recipe.world.dt_s, recipe.world.history_steps, recipe.scenes).map_err(from_model)?;
    Ok(Box::new(policy))
}

impl Recipe<'_> {
    fn options<T: DeserializeOwned>(&self) -> PyResult<T> {
        T::deserialize(self.options)
            .map_err(|e| py::ConfigError::new_err(format!("config: policies: {}: {e}", self.name)))
    }
}

/// Default options of the kinds that are policies by their own name, in the form of [`WorldConfig::policies`].
pub(crate) fn default_policies() -> PyResult<BTreeMap<String, Value>> {
    let options =
        serde_json::to_value(CcdiffConfig::default()).map_err(|e| py::ConfigError::new_err(e.to_string()))?;
    let kinds = ModelKind::ALL.map(ModelKind::name);
    Ok(kinds.map(|kind| (kind.to_owned(), serde_json::json!({ kind: options }))).into())
}

/// The policies of a configuration beside those that every batch has: those that somebody drives by, and all under
/// names of their own.
pub(crate) fn policies(
    config: &WorldConfig,
    scenes: &[Arc<Scene>],
    weights: &BTreeMap<String, PathBuf>,
    models: &BTreeMap<String, Py<PyAny>>,
) -> PyResult<Vec<(String, Box<dyn TrafficPolicy>)>> {
    let mut made = Vec::new();
    for (name, policy) in &config.policies {
        let one = policy.as_object().filter(|o| o.len() == 1).and_then(|o| o.iter().next());
        let kind = one.and_then(|(kind, options)| Some((KINDS.iter().find(|k| k.name == kind)?, options)));
        let Some((kind, options)) = kind else {
            let kinds: Vec<&str> = KINDS.iter().map(|k| k.name).collect();
            let kinds = kinds.join(", ");
            let message =
                format!("config: policies: {name} is {policy}, expected {{kind: options}} of {kinds}");
            return Err(py::ConfigError::new_err(message));
        };
        if kind.name != name || config.names(name) {
            let (weights, model) = (weights.get(name), models.get(name));
            let recipe = Recipe { name, kind: kind.name, options, weights, model, world: config, scenes };
            made.push((name.clone(), (kind.make)(&recipe)?));
        }
    }
    Ok(made)
}
