//! Bindings of `ccdiff_sim::causal`: measures, the decision causal graph, rankings.

use crate::enter::flags;
use ccdiff_bridge::errors::{from_sim, py::ShapeError, py::UnknownNameError};
use ccdiff_sim::causal::graph::{CausalGraph, GraphThresholds};
use ccdiff_sim::causal::measures::{AgentFrame, AgentHistory, Ttc};
use ccdiff_sim::causal::rank::{
    CliqueSettings, GreedyOrder, RankInput, Ranker, Ranking, clique_occurrences, greedy_order,
};
use numpy::{
    PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;

/// Adds the functions of this file to the module.
pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let GraphThresholds { ttc_s, distance_m } = GraphThresholds::PAPER;
    module.add("GRAPH_THRESHOLDS", (ttc_s, distance_m))?;
    module.add_function(wrap_pyfunction!(causal_ttc, module)?)?;
    module.add_function(wrap_pyfunction!(causal_distance, module)?)?;
    module.add_function(wrap_pyfunction!(causal_graph, module)?)?;
    module.add_function(wrap_pyfunction!(causal_clique_occurrences, module)?)?;
    module.add_function(wrap_pyfunction!(causal_greedy_order, module)?)?;
    module.add_function(wrap_pyfunction!(causal_rank, module)?)
}

fn unknown(what: &str, got: &str, expected: &str) -> PyErr {
    UnknownNameError::new_err(format!("unknown {what} {got:?}, expected {expected}"))
}

/// M of [M, M] or [T, M, M].
fn square(what: &str, shape: &[usize]) -> PyResult<usize> {
    match shape {
        [.., rows, columns] if rows == columns => Ok(*rows),
        _ => Err(ShapeError::new_err(format!("{what} has shape {shape:?}, expected [..., M, M]"))),
    }
}

type States<'py> = PyReadonlyArray2<'py, f32>;
type Sizes<'py> = PyReadonlyArray1<'py, f32>;

/// The recorded states [T, M] of agents with their sizes [M].
fn history<'a>(
    [x, y, heading, speed]: [&'a States<'_>; 4],
    [length, width]: [&'a Sizes<'_>; 2],
    valid: &'a [bool],
) -> PyResult<AgentHistory<'a>> {
    AgentHistory::new(AgentFrame {
        x_m: x.as_slice()?,
        y_m: y.as_slice()?,
        heading_rad: heading.as_slice()?,
        speed_mps: speed.as_slice()?,
        length_m: length.as_slice()?,
        width_m: width.as_slice()?,
        valid,
        apart: &[],
    })
    .map_err(from_sim)
}

/// Times to contact [T, M, M], seconds, from states [T, M] and sizes [M].
#[pyfunction]
fn causal_ttc<'py>(
    py: Python<'py>,
    x: States<'py>,
    y: States<'py>,
    heading: States<'py>,
    speed: States<'py>,
    length: Sizes<'py>,
    width: Sizes<'py>,
    valid: PyReadonlyArray2<'py, bool>,
    method: &str,
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let ttc = match method {
        "oriented" => Ttc::Oriented,
        "released" => Ttc::Released,
        _ => return Err(unknown("TTC method", method, "\"oriented\" or \"released\"")),
    };
    let valid = flags(&valid)?;
    let history = history([&x, &y, &heading, &speed], [&length, &width], &valid)?;
    let out = py.detach(|| history.ttc_s(ttc));
    let shape = [x.shape()[0], history.num_agents(), history.num_agents()];
    PyArray1::from_vec(py, out).reshape(shape)
}

/// Distances of the centres [T, M, M], metres, from states [T, M].
#[pyfunction]
fn causal_distance<'py>(
    py: Python<'py>,
    x: States<'py>,
    y: States<'py>,
    valid: PyReadonlyArray2<'py, bool>,
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let (num_agents, valid) = (x.shape()[1], flags(&valid)?);
    let (zeros, sizes) = (vec![0.0; x.len()], vec![0.0; num_agents]);
    let (x_m, y_m) = (x.as_slice()?, y.as_slice()?);
    let (heading_rad, speed_mps, length_m, width_m) = (&zeros[..], &zeros[..], &sizes[..], &sizes[..]);
    let frame = AgentFrame { x_m, y_m, heading_rad, speed_mps, length_m, width_m, valid: &valid, apart: &[] };
    let history = AgentHistory::new(frame).map_err(from_sim)?;
    let out = history.distance_m().map_err(from_sim)?;
    PyArray1::from_vec(py, out).reshape([x.shape()[0], num_agents, num_agents])
}

/// The decision causal graph [M, M].
#[pyfunction]
fn causal_graph<'py>(
    py: Python<'py>,
    ttc_s: PyReadonlyArray2<'py, f32>,
    distance_m: PyReadonlyArray2<'py, f32>,
    max_ttc_s: f32,
    max_distance_m: f32,
) -> PyResult<Bound<'py, PyArray2<bool>>> {
    let num_agents = square("ttc_s", ttc_s.shape())?;
    let thresholds = GraphThresholds { ttc_s: max_ttc_s, distance_m: max_distance_m };
    let graph = CausalGraph::from_measures(num_agents, ttc_s.as_slice()?, distance_m.as_slice()?, thresholds)
        .map_err(from_sim)?;
    PyArray1::from_slice(py, graph.as_slice()).reshape([num_agents, num_agents])
}

/// Agents, their counts, cliques counted, and whether every search was completed.
#[pyfunction]
fn causal_clique_occurrences(
    py: Python<'_>,
    measure: PyReadonlyArray3<'_, f64>,
    threshold: f64,
    min_size: usize,
    top_per_frame: usize,
    node_limit: usize,
) -> PyResult<(Vec<usize>, Vec<usize>, usize, bool)> {
    let num_agents = square("measure", measure.shape())?;
    let settings = CliqueSettings { threshold, min_size, top_per_frame, node_limit };
    let matrices = measure.as_slice()?;
    let found = py.detach(|| clique_occurrences(num_agents, matrices, &settings)).map_err(from_sim)?;
    let (agents, counts) = found.counts.into_iter().unzip();
    Ok((agents, counts, found.num_cliques, found.exact))
}

fn greedy_order_named(order: &str) -> PyResult<GreedyOrder> {
    match order {
        "size" => Ok(GreedyOrder::SizeThenWeight),
        "occurrences" => Ok(GreedyOrder::Occurrences),
        _ => Err(unknown("greedy order", order, "\"size\" or \"occurrences\"")),
    }
}

/// Agents by the cliques grown greedily from each of them.
#[pyfunction]
fn causal_greedy_order(weights: PyReadonlyArray2<'_, f64>, order: &str) -> PyResult<Vec<usize>> {
    let num_agents = square("weights", weights.shape())?;
    greedy_order(num_agents, weights.as_slice()?, greedy_order_named(order)?).map_err(from_sim)
}

/// Key agents by a named ranker, filled up; how many the ranker named; whether clique searches were completed.
#[pyfunction]
#[pyo3(signature = (ranker, top_k, valid, ttc, distance, agents, scores, seed, settings))]
fn causal_rank(
    py: Python<'_>,
    ranker: &str,
    top_k: usize,
    valid: PyReadonlyArray1<'_, bool>,
    ttc: Option<PyReadonlyArray3<'_, f32>>,
    distance: Option<PyReadonlyArray3<'_, f32>>,
    agents: Option<Vec<usize>>,
    scores: Option<PyReadonlyArray1<'_, f32>>,
    seed: u64,
    settings: (f64, usize, usize, usize),
) -> PyResult<(Vec<usize>, usize, bool)> {
    let (threshold, min_size, top_per_frame, node_limit) = settings;
    let settings = CliqueSettings { threshold, min_size, top_per_frame, node_limit };
    let ranker = match ranker {
        "cliques" => Ranker::CliqueOccurrence(settings),
        "distance_cliques" => Ranker::DistanceCliques(settings),
        "first" => Ranker::FirstK,
        "random" => Ranker::Random { seed },
        "listed" => Ranker::Listed(agents.unwrap_or_default()),
        "scores" => Ranker::Scores,
        _ => {
            let expected =
                "\"cliques\", \"distance_cliques\", \"first\", \"random\", \"listed\" or \"scores\"";
            return Err(unknown("ranker", ranker, expected));
        }
    };
    let input = RankInput {
        valid: &flags(&valid)?,
        ttc: ttc.as_ref().map_or(Ok(&[][..]), |a| a.as_slice())?,
        distance: distance.as_ref().map_or(Ok(&[][..]), |a| a.as_slice())?,
        scores: scores.as_ref().map(|a| a.as_slice()).transpose()?,
        ..RankInput::default()
    };
    let Ranking { agents, num_named, exact } = py.detach(|| ranker.rank(&input, top_k)).map_err(from_sim)?;
    Ok((agents, num_named, exact))
}
