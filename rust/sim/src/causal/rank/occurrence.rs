//! Ranking by occurrence in heavy cliques: how often an agent is part of the heaviest cliques over some steps.

use super::clique_search::WeightedGraph;
use crate::error::{Result, SimError};
use crate::geom::Real;

/// Settings of the ranking by clique occurrence.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CliqueSettings {
    /// Agents are joined where their measure, 1 for near and 0 for far, exceeds this in either direction.
    pub threshold: f64,
    /// Smallest clique that counts, agents.
    pub min_size: usize,
    /// Heaviest cliques taken at every step.
    pub top_per_frame: usize,
    /// Cliques that the search may visit at one step before it settles for the heaviest seen.
    pub node_limit: usize,
}

impl CliqueSettings {
    /// What made the released lists of key agents: any contact within 20 s joins, pairs count (reference.md#shipped-lists).
    pub const REFERENCE_IMPL: Self =
        Self { threshold: 0.0, min_size: 2, top_per_frame: 3, node_limit: 20_000 };
}

/// Agents by falling number of the heaviest cliques of every step that they take part in, then by first appearance; and
/// whether the search was completed at every step. `measure` [T, M, M] is in [0, 1], or NaN for absent agents.
///
/// Differs from the paper: cliques are those of the time-to-contact (or distance) graph alone, over several steps,
/// as in the authors' release (reference.md#released-script); those on G are in [`super::greedy`].
pub(super) fn clique_occurrences(
    num_agents: usize,
    measure: &[Real],
    settings: &CliqueSettings,
) -> Result<(Vec<usize>, bool)> {
    let pairs = num_agents * num_agents;
    let ragged = if pairs == 0 { measure.len() } else { measure.len() % pairs };
    if ragged != 0 {
        return Err(SimError::Length { what: "last matrix of the measure", got: ragged, expected: pairs });
    }
    if settings.threshold.is_nan() || settings.threshold < 0.0 {
        return Err(SimError::config("rank.threshold", settings.threshold, "at least 0"));
    }
    if let Some(bad) = measure.iter().find(|v| **v < 0.0 || **v > 1.0) {
        return Err(SimError::config("rank.measure", bad, "a normalised measure in [0, 1]"));
    }
    let (mut counts, mut exact) = (Vec::<(usize, usize)>::new(), true);
    for matrix in measure.chunks_exact(pairs.max(1)) {
        let value = |i: usize, j: usize| f64::from(matrix[i * num_agents + j]);
        let graph = WeightedGraph::from_measure(num_agents, settings.threshold, value);
        let (cliques, completed) =
            graph.heaviest_cliques(settings.min_size, settings.top_per_frame, settings.node_limit);
        exact &= completed;
        for agent in cliques.into_iter().flatten() {
            match counts.iter_mut().find(|(a, _)| *a == agent) {
                Some((_, count)) => *count += 1,
                None => counts.push((agent, 1)),
            }
        }
    }
    counts.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
    Ok((counts.into_iter().map(|(agent, _)| agent).collect(), exact))
}
