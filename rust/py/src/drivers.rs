//! The kinds of drivers that there are, and the policies of a batch of worlds: the one place that names them.

use crate::python_policy::PythonPolicy;
use ccdiff_bridge::Policy;
use ccdiff_bridge::errors::{from_sim, py};
use ccdiff_render::DrawStyle;
use ccdiff_sim::options::{self, Setting};
use ccdiff_sim::policy::Idm;
use ccdiff_sim::world::WorldConfig;
use pyo3::prelude::*;
use pyo3::types::PyCapsule;
use serde::de::DeserializeOwned;
use serde_json::Value;
use std::collections::BTreeMap;

/// What a policy is made from.
struct Recipe<'a> {
    /// Name in the batch.
    name: &'a str,
    /// Options as JSON.
    options: &'a Value,
    /// The object behind a Python model.
    model: Option<&'a Py<PyAny>>,
}

type Make = fn(&Recipe<'_>) -> PyResult<Policy>;

/// A kind of policy that takes options of its own.
struct Kind {
    /// Name in configurations.
    name: &'static str,
    /// Name in reports.
    title: &'static str,
    /// Whose colour it has in images.
    drawn: DrawStyle,
    /// How it is made here; policies with a network are made by `_models`.
    make: Option<Make>,
}

const fn kind(name: &'static str, title: &'static str, drawn: DrawStyle, make: Option<Make>) -> Kind {
    Kind { name, title, drawn, make }
}

/// The kinds. A new one is a line here; `replay` and `constant_velocity` have no options and are always there.
const KINDS: [Kind; 11] = [
    kind("idm", "IDM", DrawStyle::Idm, Some(idm)),
    kind("python", "Python model", DrawStyle::Other, Some(python)),
    kind("ccdiff", "CCDiff", DrawStyle::Ccdiff, None),
    kind("simnet", "SimNet", DrawStyle::Ccdiff, None),
    kind("trafficsim", "TrafficSim", DrawStyle::Ccdiff, None),
    kind("trafficsim_port", "TrafficSim (port)", DrawStyle::Ccdiff, None),
    kind("strive", "STRIVE", DrawStyle::Ccdiff, None),
    kind("bits", "BITS", DrawStyle::Ccdiff, None),
    kind("ctg", "CTG", DrawStyle::Ccdiff, None),
    kind("ctgpp", "CTG++", DrawStyle::Ccdiff, None),
    kind("tokens", "Tokens", DrawStyle::Ccdiff, None),
];

/// Adds the functions of this file to the module.
pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(networks_wanted, module)?)?;
    module.add_function(wrap_pyfunction!(drivers, module)?)
}

/// How images show a kind of driver.
pub(crate) fn drawn(kind: &str) -> DrawStyle {
    let drawn = DrawStyle::ALL.into_iter().find(|d| d.name() == kind);
    let like = KINDS.iter().find(|k| k.name == kind).map(|k| k.drawn);
    drawn.or(like).unwrap_or(DrawStyle::Other)
}

/// What legends call a kind of driver.
pub(crate) fn title(kind: &str) -> &'static str {
    let own = KINDS.iter().find(|k| k.name == kind).map(|k| k.title);
    own.unwrap_or_else(|| drawn(kind).title())
}

/// Name, title and number in images.
type Row = (&'static str, &'static str, u8);

/// Name, title and number in images of everybody who may move an agent: those that images tell apart, in
/// the order of their numbers, then the kinds that look like one of them.
#[pyfunction]
fn drivers() -> Vec<Row> {
    let drawn = DrawStyle::ALL.iter().map(|d| (d.name(), d.title(), *d as u8));
    let others = KINDS.iter().filter(|k| k.drawn.name() != k.name);
    drawn.chain(others.map(|k| (k.name, k.title, k.drawn as u8))).collect()
}

fn idm(recipe: &Recipe<'_>) -> PyResult<Policy> {
    Ok(Box::new(Idm { config: recipe.options("idm")? }))
}

/// Traffic of a model of the user's own.
fn python(recipe: &Recipe<'_>) -> PyResult<Policy> {
    let model = recipe.model.ok_or_else(|| {
        let message = format!("config: policies: {}: no Python object was handed over", recipe.name);
        py::ConfigError::new_err(message)
    })?;
    let model = Python::attach(|py| model.clone_ref(py));
    Ok(Box::new(PythonPolicy::new(recipe.name, recipe.options("python")?, model)))
}

impl Recipe<'_> {
    fn options<T: Setting + DeserializeOwned>(&self, kind: &str) -> PyResult<T> {
        let own = self.name != kind;
        let path = if own { format!("policies.{}.{kind}", self.name) } else { kind.to_owned() };
        options::read(&path, &self.options.to_string()).map_err(from_sim)
    }
}

/// What is to be made beside the policies that every batch has: what somebody drives by, and all under names of their own.
fn recipes<'a>(
    config: &'a WorldConfig,
    models: &'a BTreeMap<String, Py<PyAny>>,
) -> PyResult<Vec<(&'static Kind, Recipe<'a>)>> {
    let mut found = Vec::new();
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
            found.push((kind, Recipe { name, options, model: models.get(name) }));
        }
    }
    Ok(found)
}

/// Policies of a configuration (JSON) that need a network: name, kind, options as JSON.
#[pyfunction]
fn networks_wanted(config: &str) -> PyResult<Vec<(String, &'static str, String)>> {
    let config = WorldConfig::from_json(config).map_err(from_sim)?;
    let none = BTreeMap::new();
    let wanted = recipes(&config, &none)?.into_iter().filter(|(kind, _)| kind.make.is_none());
    Ok(wanted.map(|(kind, r)| (r.name.to_owned(), kind.name, r.options.to_string())).collect())
}

/// The policies in capsules of the module of networks, by name.
pub(crate) fn taken(capsules: BTreeMap<String, Bound<'_, PyCapsule>>) -> PyResult<BTreeMap<String, Policy>> {
    capsules.iter().map(|(name, capsule)| Ok((name.clone(), ccdiff_bridge::taken_policy(capsule)?))).collect()
}

/// The policies of a configuration beside those that every batch has.
pub(crate) fn policies(
    config: &WorldConfig,
    mut networks: BTreeMap<String, Policy>,
    models: &BTreeMap<String, Py<PyAny>>,
) -> PyResult<Vec<(String, Policy)>> {
    let mut made = Vec::new();
    for (kind, recipe) in recipes(config, models)? {
        let policy = match (kind.make, networks.remove(recipe.name)) {
            (Some(make), _) => make(&recipe)?,
            (None, Some(policy)) => policy,
            (None, None) => {
                let message = format!("config: policies: {}: no network was handed over", recipe.name);
                return Err(py::ConfigError::new_err(message));
            }
        };
        made.push((recipe.name.to_owned(), policy));
    }
    Ok(made)
}
