//! The kinds of drivers that there are, and the policies of a batch of worlds: the one place that names them.

use crate::errors::{from_sim, py};
use crate::models::from_model;
use ccdiff_models::ModelKind;
use ccdiff_models::traffic::{CcdiffConfig, PlannedTraffic};
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
    world: &'a WorldConfig,
    scenes: &'a [Arc<Scene>],
}

type Make = fn(&Recipe<'_>) -> PyResult<Box<dyn TrafficPolicy>>;

/// Kinds of policies that take options of their own: name in configurations, and how one is made. `replay` and
/// `constant_velocity` have no options and are always there.
const KINDS: [(&str, Make); 9] = [
    ("idm", idm),
    ("ccdiff", network),
    ("simnet", network),
    ("trafficsim", network),
    ("trafficsim_port", network),
    ("strive", network),
    ("bits", network),
    ("ctg", network),
    ("ctgpp", network),
];

fn idm(recipe: &Recipe<'_>) -> PyResult<Box<dyn TrafficPolicy>> {
    let config: IdmConfig = recipe.options()?;
    if let Some((field, got, expected)) = config.first_fault() {
        let error = SimError::Config { field, got: got.to_string(), expected: expected.into() };
        return Err(from_sim(error));
    }
    Ok(Box::new(Idm { config }))
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
) -> PyResult<Vec<(String, Box<dyn TrafficPolicy>)>> {
    let mut made = Vec::new();
    for (name, policy) in &config.policies {
        let one = policy.as_object().filter(|o| o.len() == 1).and_then(|o| o.iter().next());
        let kind = one.and_then(|(kind, options)| {
            let known = KINDS.iter().find(|(known, _)| known == kind)?;
            Some((known, options))
        });
        let Some(((kind, make), options)) = kind else {
            let kinds = KINDS.map(|(kind, _)| kind).join(", ");
            let message =
                format!("config: policies: {name} is {policy}, expected {{kind: options}} of {kinds}");
            return Err(py::ConfigError::new_err(message));
        };
        if *kind != name || config.names(name) {
            let recipe = Recipe { name, kind, options, weights: weights.get(name), world: config, scenes };
            made.push((name.clone(), make(&recipe)?));
        }
    }
    Ok(made)
}
