//! The kinds of drivers, and the drivers of a batch of worlds.

use crate::python_driver::{self, PythonDriver};
use crate::{egos, swift};
use ccdiff_bridge::errors::{from_sim, py};
use ccdiff_bridge::{AskedDriver, BoxedDriver, path_of, take_driver};
use ccdiff_nets::NetworkKind;
use ccdiff_nets::networks::NETWORKS;
use ccdiff_nets::networks::ccdiff::CCDIFF;
use ccdiff_nets::traffic::egos::EGOS;
use ccdiff_nets::traffic::swift::SWIFT;
use ccdiff_nets::traffic::{DRIVERS, PlannedTraffic};
use ccdiff_render::DrawStyle;
use ccdiff_sim::drivers::{KINDS, Kind};
use ccdiff_sim::options;
use ccdiff_sim::scene::Scene;
use ccdiff_sim::world::WorldConfig;
use pyo3::prelude::*;
use pyo3::types::{PyCapsule, PyDict};
use serde_json::Value;
use std::num::NonZero;
use std::path::PathBuf;
use std::sync::Arc;
use std::thread::available_parallelism;

/// All kinds: the simulator's, Python's, the networks, egos, swift traffic.
pub(crate) fn kinds() -> impl Iterator<Item = &'static Kind> {
    let own = KINDS.iter().chain([&python_driver::KIND]);
    own.chain(&DRIVERS).chain([&EGOS, &SWIFT])
}

/// The network under whose name the options stand that all networks share.
const SHARED: &str = CCDIFF.kind.name;

/// Whether a driver takes the options that networks share.
fn is_network(kind: &Kind) -> bool {
    kind.name == SWIFT.name || NETWORKS.iter().any(|network| network.kind.name == kind.name)
}

fn find_kind(name: &str) -> Option<&'static Kind> {
    kinds().find(|kind| kind.name == name)
}

/// How images show a kind of driver.
fn style_of(kind: &str) -> DrawStyle {
    let style = find_kind(kind).map_or(kind, |kind| kind.style);
    match NETWORKS.iter().find(|network| network.kind.name == kind) {
        Some(network) if !network.denoises => DrawStyle::Network,
        _ => DrawStyle::ALL.into_iter().find(|drawn| drawn.name() == style).unwrap_or(DrawStyle::Other),
    }
}

/// What legends call a kind of driver.
fn title(kind: &str) -> &'static str {
    find_kind(kind).map_or_else(|| style_of(kind).title(), |kind| kind.title)
}

/// Name, title and number in images.
type Row = (&'static str, &'static str, u8);

/// Name, title and number in images of all that may move an agent: those that images tell apart, in the order of their
/// numbers, then the kinds that look like one of them.
#[pyfunction]
pub(crate) fn drivers() -> Vec<Row> {
    let styles = DrawStyle::ALL.iter().map(|d| (d.name(), title(d.name()), *d as u8));
    let others = kinds().filter(|kind| style_of(kind.name).name() != kind.name);
    styles.chain(others.map(|kind| (kind.name, kind.title, style_of(kind.name) as u8))).collect()
}

/// All kinds of drivers, one dictionary each: `name`, `title`, `options` (name of their table or `None`), `always` (every batch
/// has one), and of networks `weights`, `denoises`, `attends`, `one_plan`, `distilled`.
#[pyfunction]
pub(crate) fn driver_kinds(py: Python<'_>) -> PyResult<Vec<Bound<'_, PyDict>>> {
    let network_of = |kind: &Kind| NETWORKS.iter().find(|network| network.kind.name == kind.name);
    kinds()
        .map(|kind| {
            let dict = PyDict::new(py);
            dict.set_item("name", kind.name)?;
            dict.set_item("title", kind.title)?;
            dict.set_item("options", kind.options.map(|table| table.name))?;
            dict.set_item("always", kind.always)?;
            if kind.name == SWIFT.name {
                dict.set_item("weights", ["fast"])?;
                dict.set_item("distilled", true)?;
            }
            if let Some(NetworkKind { weights, denoises, attends, one_plan, .. }) = network_of(kind) {
                dict.set_item("weights", weights.to_vec())?;
                dict.set_item("denoises", denoises)?;
                dict.set_item("attends", attends)?;
                dict.set_item("one_plan", one_plan)?;
            }
            Ok(dict)
        })
        .collect()
}

/// What is to be made beside the drivers that every batch has, those that agents have and all under names of their own: kind,
/// name in the batch, options as JSON.
fn list_recipes(config: &WorldConfig) -> PyResult<Vec<(&'static Kind, &str, String)>> {
    let mut found = Vec::new();
    for (name, driver) in &config.named_drivers {
        let one = driver.as_object().filter(|o| o.len() == 1).and_then(|o| o.iter().next());
        let Some((kind, options)) =
            one.and_then(|(kind, options)| Some((find_kind(kind).filter(|k| k.options.is_some())?, options)))
        else {
            let kinds: Vec<&str> = kinds().filter(|kind| kind.options.is_some()).map(|k| k.name).collect();
            let kinds = kinds.join(", ");
            let message =
                format!("config: named_drivers: {name} is {driver}, expected {{kind: options}} of {kinds}");
            return Err(py::ConfigError::new_err(message));
        };
        if kind.name != name || config.names(name) {
            found.push((kind, name.as_str(), options.to_string()));
        }
    }
    // a driver of a kind without options of its own has those that all networks share, or the default ones
    let shared = config.named_drivers.get(SHARED).and_then(|driver| driver.get(SHARED));
    for kind in
        kinds().filter(|k| !k.always && config.names(k.name) && !config.named_drivers.contains_key(k.name))
    {
        let shared = shared.filter(|_| is_network(kind));
        if shared.is_none() && kind.make.is_none() && kind.name != EGOS.name {
            continue;
        }
        found.push((kind, kind.name, shared.map_or_else(|| "{}".to_owned(), Value::to_string)));
    }
    Ok(found)
}

/// The drivers of a configuration beside those that every batch has. `hand`, called with name, kind, options (JSON) and number of
/// threads, hands in what a driver is made of that is not known here: the model of Python; the file of weights and the options of a
/// network, or the driver itself where torch computes it; the parts of an ego ([`egos::driver`]).
pub(crate) fn make_drivers(
    config: &WorldConfig,
    scenes: &[Arc<Scene>],
    num_threads: usize,
    hand: Option<&Bound<'_, PyAny>>,
) -> PyResult<Vec<(String, BoxedDriver)>> {
    let num_threads = num_threads.min(available_parallelism().map_or(1, NonZero::get));
    let mut made = Vec::new();
    for (kind, name, options) in list_recipes(config)? {
        let path = path_of(name, kind.name);
        let driver = match (kind.make, hand) {
            (Some(make), _) => make(&path, &options).map_err(from_sim)?,
            (None, Some(hand)) => {
                let handed = hand.call1((name, kind.name, &options, num_threads))?;
                if kind.name == python_driver::KIND.name {
                    let options = options::read(&path, &options).map_err(from_sim)?;
                    Box::new(PythonDriver::new(name, options, handed.unbind()))
                } else if kind.name == EGOS.name {
                    egos::driver(&handed)?
                } else if let Ok(capsule) = handed.cast::<PyCapsule>() {
                    take_driver(capsule)?
                } else {
                    let (weights, options): (PathBuf, String) = handed.extract()?;
                    let (py, dt_s) = (handed.py(), config.dt_s);
                    let asked = AskedDriver { name, kind: kind.name, options: &options, dt_s, scenes };
                    if kind.name == SWIFT.name {
                        swift::driver(py, name, &options, &weights, dt_s, num_threads)?
                    } else {
                        asked.driver(py, |config| PlannedTraffic::new(config, &weights, num_threads))?
                    }
                }
            }
            (None, None) => {
                let message =
                    format!("config: named_drivers: {name}: the driver has no network or Python model");
                return Err(py::ConfigError::new_err(message));
            }
        };
        made.push((name.to_owned(), driver));
    }
    Ok(made)
}

/// A configuration as worlds are told apart by it: options of drivers are those that are not the default.
pub(crate) fn without_defaults(config: WorldConfig) -> WorldConfig {
    let mut named_drivers = config.named_drivers;
    for (kind, options) in named_drivers.values_mut().filter_map(Value::as_object_mut).flatten() {
        if let Some(table) = find_kind(kind).and_then(|kind| kind.options) {
            options::without_defaults(table, options);
        }
    }
    WorldConfig { named_drivers, ..config }
}
