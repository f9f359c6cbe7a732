//! Swift traffic: the driver, and what it sees as rows, for training.

use ccdiff_bridge::errors::{from_sim, from_weights, py};
use ccdiff_bridge::{BoxedDriver, contained, path_of};
use ccdiff_nets::compute::weights::read;
use ccdiff_nets::networks::tokens::token_of;
use ccdiff_nets::traffic::swift::{EGO, NEIGHBOURS, OTHER, OWN, Rows, STATES, SWIFT, Swift, egos_of};
use ccdiff_sim::drivers::WorldView;
use ccdiff_sim::options;
use numpy::{PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use std::path::Path;

/// Bins [n, 2] of changes of speed (m/s in half a second) and yaw rates (rad/s).
#[pyfunction]
pub(crate) fn swift_bins(changes: Vec<(f32, f32)>) -> Vec<[usize; 2]> {
    changes.into_iter().map(|(speed, yaw_rate)| token_of(speed, yaw_rate)).collect()
}

/// The driver of a name; `settings` is a `CcdiffConfig` as JSON.
pub(crate) fn driver(
    py: Python<'_>,
    name: &str,
    settings: &str,
    weights: &Path,
    dt_s: f32,
    num_threads: usize,
) -> PyResult<BoxedDriver> {
    let config = options::read(&path_of(name, SWIFT.name), settings).map_err(from_sim)?;
    let made = py.detach(|| Swift::new(config, weights, read(weights)?, dt_s, num_threads));
    Ok(contained(Box::new(made.map_err(from_weights)?)))
}

/// What it would see of some vehicles, a row of each: itself and its route, the ego, [`NEIGHBOURS`] others, and how many they are.
pub(crate) fn rows<'py>(
    py: Python<'py>,
    world: &WorldView<'_>,
    agents: &[usize],
) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let count = world.states.len();
    let Some(history) = world.history.filter(|h| h.len() >= STATES) else {
        let message = format!("swift_rows: expected a driver that looks back at {STATES} states or more");
        return Err(py::ConfigError::new_err(message));
    };
    if let Some(a) = agents.iter().find(|a| **a >= count || !world.states.active[**a]) {
        return Err(py::UnknownNameError::new_err(format!(
            "agent {a}: expected one that is there, below {count}"
        )));
    }
    let (mut rows, egos) = (Rows::default(), egos_of(world));
    agents.iter().for_each(|a| rows.add(world, history, *a, &egos));
    const ROW: usize = OWN + EGO + NEIGHBOURS * OTHER + 1;
    let (mut all, mut others) = (Vec::with_capacity(agents.len() * ROW), rows.others.as_slice());
    for (i, seen) in rows.seen.iter().enumerate() {
        let (these, rest) = others.split_at(seen * OTHER);
        others = rest;
        all.extend(rows.own[i * OWN..][..OWN].iter().chain(&rows.ego[i * EGO..][..EGO]).chain(these));
        all.resize((i + 1) * ROW - 1, 0.0);
        all.push(*seen as f32);
    }
    PyArray1::from_vec(py, all).reshape([agents.len(), ROW])
}
