//! What a traffic model in Python is told, as arrays: the same in running worlds and from a log.

use ccdiff_sim::geom::Real;
use ccdiff_sim::scene::AgentKind;
use ccdiff_sim::stage::{History, PastState, PreparedScene};
use numpy::{Element, PyArray1, PyArrayDyn, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Distance between places on a route, metres.
pub(crate) const ROUTE_SPACING_M: Real = 2.0;

/// An agent of a batch.
pub(crate) struct Row {
    /// Index in its scene.
    pub(crate) agent_idx: usize,
    /// Whether the model drives it.
    pub(crate) drives: bool,
    /// Whether it is the ego, or driven from outside.
    pub(crate) is_ego: bool,
    /// Where it is on its route, metres.
    pub(crate) route_s_m: Real,
}

/// A world of a batch.
pub(crate) struct Told<'a> {
    pub(crate) scene: &'a PreparedScene,
    pub(crate) scene_idx: usize,
    /// At least as many states as are told.
    pub(crate) history: &'a History,
    pub(crate) elapsed_steps: usize,
    pub(crate) seed: u64,
    /// Strength that was asked for.
    pub(crate) criticality: Real,
    /// The agents that are there.
    pub(crate) rows: Vec<Row>,
}

fn shaped<'py, T: Element>(
    py: Python<'py>,
    values: Vec<T>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    PyArray1::from_vec(py, values).reshape(shape)
}

/// Sets states [M, K] as arrays: positions, headings, speeds, and whether the agent was there.
pub(crate) fn set_states(dict: &Bound<'_, PyDict>, states: &[PastState], shape: [usize; 2]) -> PyResult<()> {
    let (py, [m, k]) = (dict.py(), shape);
    let position = states.iter().flat_map(|p| [p.position.x, p.position.y]).collect();
    dict.set_item("position_m", shaped::<f32>(py, position, &[m, k, 2])?)?;
    let heading = states.iter().map(|p| p.heading_rad).collect();
    dict.set_item("heading_rad", shaped::<f32>(py, heading, &[m, k])?)?;
    let speed = states.iter().map(|p| p.speed_mps).collect();
    dict.set_item("speed_mps", shaped::<f32>(py, speed, &[m, k])?)?;
    dict.set_item("valid", shaped(py, states.iter().map(|p| p.valid).collect(), &[m, k])?)
}

/// Places on the routes of vehicles [M, P, 2] from where they are, and whether the route goes so far [M, P].
fn set_routes(
    dict: &Bound<'_, PyDict>,
    worlds: &[Told<'_>],
    num_rows: usize,
    num_points: usize,
) -> PyResult<()> {
    let (py, places) = (dict.py(), num_rows * num_points);
    let (mut points, mut told) = (Vec::with_capacity(2 * places), Vec::with_capacity(places));
    for (world, row) in worlds.iter().flat_map(|w| w.rows.iter().map(move |row| (w, row))) {
        let path = &world.scene.routes[row.agent_idx].path;
        let is_vehicle = world.scene.kinds[row.agent_idx] == AgentKind::Vehicle;
        for k in 0..num_points {
            let s_m = row.route_s_m + k as Real * ROUTE_SPACING_M;
            let is_there = is_vehicle && s_m <= path.length_m();
            let at = if is_there { path.at(s_m).position.coords.into() } else { [0.0; 2] };
            points.extend(at);
            told.push(is_there);
        }
    }
    dict.set_item("route_m", shaped::<f32>(py, points, &[num_rows, num_points, 2])?)?;
    dict.set_item("route_valid", shaped::<bool>(py, told, &[num_rows, num_points])?)
}

/// What the model is told: M agents of W worlds, H states and P places on the route each.
pub(crate) fn arrays<'py>(
    py: Python<'py>,
    worlds: &[Told<'_>],
    num_states: usize,
    num_points: usize,
) -> PyResult<Bound<'py, PyDict>> {
    let rows: Vec<(usize, &Row)> =
        worlds.iter().enumerate().flat_map(|(w, world)| world.rows.iter().map(move |row| (w, row))).collect();
    let (m, w) = (rows.len(), worlds.len());
    let dict = PyDict::new(py);
    let past = rows.iter().flat_map(|(w, row)| {
        let history = worlds[*w].history;
        let first = history.len().saturating_sub(num_states);
        (first..history.len()).map(move |k| history.at(row.agent_idx, k))
    });
    set_states(&dict, &past.collect::<Vec<_>>(), [m, num_states])?;
    set_routes(&dict, worlds, m, num_points)?;
    let footprint = |(w, row): &(usize, &Row)| {
        let agent = &worlds[*w].scene.scene.agents[row.agent_idx];
        [agent.length_m, agent.width_m]
    };
    dict.set_item("size_m", shaped(py, rows.iter().flat_map(footprint).collect(), &[m, 2])?)?;
    let kinds = rows.iter().map(|(w, row)| worlds[*w].scene.kinds[row.agent_idx] as u8).collect();
    dict.set_item("kind", shaped::<u8>(py, kinds, &[m])?)?;
    let drives = rows.iter().map(|(_, row)| row.drives).collect();
    dict.set_item("drives", shaped::<bool>(py, drives, &[m])?)?;
    let egos = rows.iter().map(|(_, row)| row.is_ego).collect();
    dict.set_item("is_ego", shaped::<bool>(py, egos, &[m])?)?;
    let parked = |(w, row): &(usize, &Row)| {
        let scene = worlds[*w].scene;
        scene.kinds[row.agent_idx] == AgentKind::Vehicle && scene.routes[row.agent_idx].is_parked()
    };
    dict.set_item("is_parked", shaped::<bool>(py, rows.iter().map(parked).collect(), &[m])?)?;
    let criticality = worlds.iter().map(|t| t.criticality).collect();
    dict.set_item("criticality", shaped::<f32>(py, criticality, &[w])?)?;
    dict.set_item("world", shaped(py, rows.iter().map(|(w, _)| *w as i64).collect(), &[m])?)?;
    dict.set_item("agent", shaped(py, rows.iter().map(|(_, row)| row.agent_idx as i64).collect(), &[m])?)?;
    let of_worlds = |of: &dyn Fn(&Told<'_>) -> i64| worlds.iter().map(of).collect::<Vec<_>>();
    dict.set_item("scene_idx", shaped(py, of_worlds(&|t| t.scene_idx as i64), &[w])?)?;
    dict.set_item("elapsed_steps", shaped(py, of_worlds(&|t| t.elapsed_steps as i64), &[w])?)?;
    let seeds = worlds.iter().map(|t| t.seed).collect();
    dict.set_item("seed", shaped::<u64>(py, seeds, &[w])?)?;
    Ok(dict)
}
