//! Ranking by occurrence in heavy cliques: how often an agent is part of the heaviest cliques over some steps.

use super::clique_search::WeightedGraph;
use crate::error::{Result, SimError};

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
    /// Cliques visited per step at most, unless told otherwise.
    pub const NODE_LIMIT: usize = 20_000;

    /// What made the released lists of key agents: any contact within 20 s joins, pairs count (reference.md#shipped-lists).
    pub const REFERENCE_IMPL: Self =
        Self { threshold: 0.0, min_size: 2, top_per_frame: 3, node_limit: Self::NODE_LIMIT };
}

impl Default for CliqueSettings {
    fn default() -> Self {
        Self::REFERENCE_IMPL
    }
}

/// Agents by the number of heavy cliques that hold them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Occurrences {
    /// Agent and number of cliques, by falling number; equal numbers in the order of first appearance.
    pub counts: Vec<(usize, usize)>,
    /// Cliques counted over all steps.
    pub num_cliques: usize,
    /// Whether the search was completed at every step.
    pub exact: bool,
}

/// Counts in how many of the heaviest cliques of every step each agent takes part.
///
/// Differs from the paper: cliques are those of the time-to-contact (or distance) graph alone, over several steps,
/// as in the authors' release; the paper's greedy cliques on G are in [`super::greedy`].
///
/// # Shapes
/// `measure`: [T, M, M] in normalised form, values in [0, 1] or not a number for absent agents.
///
/// # Errors
/// [`SimError::Length`] where the measure is not a whole number of [M, M] matrices, [`SimError::Config`] for values
/// outside [0, 1] or a negative threshold.
///
/// # Reference
/// reference.md#released-script and reference.md#shipped-lists.
pub fn clique_occurrences<V: Into<f64> + Copy>(
    num_agents: usize,
    measure: &[V],
    settings: &CliqueSettings,
) -> Result<Occurrences> {
    let pairs = num_agents * num_agents;
    let ragged = if pairs == 0 { measure.len() } else { measure.len() % pairs };
    if ragged != 0 {
        return Err(SimError::Length { what: "last matrix of the measure", got: ragged, expected: pairs });
    }
    if settings.threshold.is_nan() || settings.threshold < 0.0 {
        return Err(SimError::config("rank.threshold", settings.threshold, "at least 0"));
    }
    if let Some(bad) = measure.iter().map(|&v| v.into()).find(|v| *v < 0.0 || *v > 1.0) {
        return Err(SimError::config("rank.measure", bad, "a normalised measure in [0, 1]"));
    }
    let mut result = Occurrences { counts: Vec::new(), num_cliques: 0, exact: true };
    for matrix in measure.chunks_exact(pairs.max(1)) {
        let graph = WeightedGraph::from_measure(num_agents, settings.threshold, |i, j| {
            matrix[i * num_agents + j].into()
        });
        let found = graph.heaviest_cliques(settings.min_size, settings.top_per_frame, settings.node_limit);
        result.exact &= found.exact;
        result.num_cliques += found.cliques.len();
        for &agent in found.cliques.iter().flatten() {
            match result.counts.iter_mut().find(|(a, _)| *a == agent) {
                Some((_, count)) => *count += 1,
                None => result.counts.push((agent, 1)),
            }
        }
    }
    result.counts.sort_by_key(|&(_, count)| std::cmp::Reverse(count));
    Ok(result)
}
