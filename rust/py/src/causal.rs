//! Bindings of `ccdiff_sim::causal`: measures, rankings.

use crate::enter::flags;
use ccdiff_bridge::errors::{from_sim, py::UnknownNameError};
use ccdiff_sim::causal::measures::{Moving, distance_m, ttc_s};
use ccdiff_sim::causal::rank::{CliqueSettings, RankInput, Ranker, Ranking};
use ccdiff_sim::check_length;
use ccdiff_sim::geom::{Pose2, Vector2};
use ccdiff_sim::state::Footprint;
use numpy::{
    PyArray1, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;

/// Times to contact, seconds, or distances of the centres, metres, [T, M, M], from states x, y, heading, speed [T, M, 4] and
/// sizes [M, 2].
#[pyfunction]
pub(crate) fn causal_pairs<'py>(
    py: Python<'py>,
    of_contact: bool,
    states: PyReadonlyArray3<'py, f32>,
    sizes: PyReadonlyArray2<'py, f32>,
    valid: PyReadonlyArray2<'py, bool>,
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let (num_steps, num_agents) = (states.shape()[0], sizes.shape()[0]);
    let valid = flags(&valid)?;
    let (states, sizes) = (states.as_slice()?.as_chunks::<4>().0, sizes.as_slice()?.as_chunks::<2>().0);
    for (what, got) in [("states", states.len()), ("sizes", num_steps * sizes.len()), ("valid", valid.len())]
    {
        check_length(what, got, num_steps * num_agents).map_err(from_sim)?;
    }
    let moving = |k: usize| -> Moving {
        let ([x, y, heading_rad, speed_mps], [length_m, width_m]) = (states[k], sizes[k % num_agents]);
        let pose = Pose2::new(x, y, heading_rad);
        let velocity = pose.rotate(Vector2::new(speed_mps, 0.0));
        valid[k].then(|| (Footprint::new(length_m, width_m).at(&pose), velocity))
    };
    let measure = if of_contact { ttc_s } else { distance_m };
    let at_step = |t: usize| {
        let agents: Vec<Moving> = (t * num_agents..(t + 1) * num_agents).map(moving).collect();
        measure(&agents, &[])
    };
    let out = py.detach(|| (0..num_steps).flat_map(at_step).collect());
    PyArray1::from_vec(py, out).reshape([num_steps, num_agents, num_agents])
}

/// Key agents by a named ranker, filled up; how many the ranker named; whether clique searches were completed.
#[pyfunction]
#[pyo3(signature = (ranker, top_k, valid, ttc, distance, agents, scores, weights, seed, settings))]
pub(crate) fn causal_rank(
    py: Python<'_>,
    ranker: &str,
    top_k: usize,
    valid: PyReadonlyArray1<'_, bool>,
    ttc: Option<PyReadonlyArray3<'_, f32>>,
    distance: Option<PyReadonlyArray3<'_, f32>>,
    agents: Option<Vec<usize>>,
    scores: Option<PyReadonlyArray1<'_, f32>>,
    weights: Option<PyReadonlyArray2<'_, f32>>,
    seed: u64,
    settings: (f64, usize, usize, usize),
) -> PyResult<(Vec<usize>, usize, bool)> {
    let (threshold, min_size, top_per_frame, node_limit) = settings;
    let settings = CliqueSettings { threshold, min_size, top_per_frame, node_limit };
    let ranker = match ranker {
        "cliques" => Ranker::CliqueOccurrence(settings),
        "distance_cliques" => Ranker::DistanceCliques(settings),
        "greedy" => Ranker::Greedy,
        "first" => Ranker::FirstK,
        "random" => Ranker::Random { seed },
        "listed" => Ranker::Listed(agents.unwrap_or_default()),
        "scores" => Ranker::Scores,
        _ => {
            return Err(UnknownNameError::new_err(format!(
                "unknown ranker {ranker:?}, expected \"cliques\", \"distance_cliques\", \"greedy\", \"first\", \
                 \"random\", \"listed\" or \"scores\""
            )));
        }
    };
    let input = RankInput {
        valid: &flags(&valid)?,
        ttc: ttc.as_ref().map_or(Ok(&[][..]), |a| a.as_slice())?,
        distance: distance.as_ref().map_or(Ok(&[][..]), |a| a.as_slice())?,
        scores: scores.as_ref().map(|a| a.as_slice()).transpose()?,
        weights: weights.as_ref().map(|a| a.as_slice()).transpose()?,
    };
    let Ranking { agents, num_named, exact } = py.detach(|| ranker.rank(&input, top_k)).map_err(from_sim)?;
    Ok((agents, num_named, exact))
}
