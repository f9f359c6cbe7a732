//! The paper's greedy cliques on the graph G = M x attention.

use crate::error::{Result, SimError, check_length};
use std::cmp::Reverse;

/// What orders the agents once every one has grown its clique.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum GreedyOrder {
    /// Size of the agent's own clique, then its weight: the algorithm's argsort over (C, w).
    #[default]
    SizeThenWeight,
    /// Number of grown cliques that hold the agent, then the weight of its own: the main text's "occurrences".
    Occurrences,
}

/// Orders the agents by the cliques grown greedily from each of them.
///
/// Agent i's clique starts as {i}; the others are tried in order of falling weighted degree, then index, and join
/// if they are joined to every member. Its weight is the sum over its pairs. Agents without a neighbour are left out.
///
/// Differs from the paper: it leaves open the order of the vertices, the symmetrisation and ties; here the weight
/// of a pair is the larger of its two directions, and ties go to the smaller index (reference.md#greedy-cliques).
///
/// # Shapes
/// `weights`: [M, M], G times attention, entries at least 0; the diagonal is ignored.
///
/// # Errors
/// [`SimError::Length`] for a matrix that is not M * M, [`SimError::Config`] for negative or non-finite weights.
///
/// # Reference
/// Paper, algorithm "Causal discovery and Ranking".
pub fn greedy_order(num_agents: usize, weights: &[f64], order: GreedyOrder) -> Result<Vec<usize>> {
    check_length("weights of the graph", weights.len(), num_agents * num_agents)?;
    if let Some(bad) = weights.iter().find(|w| !w.is_finite() || **w < 0.0) {
        return Err(SimError::config("rank.weights", bad, "finite and at least 0"));
    }
    let weight = |i: usize, j: usize| {
        if i == j { 0.0 } else { weights[i * num_agents + j].max(weights[j * num_agents + i]) }
    };
    let degree: Vec<f64> = (0..num_agents).map(|i| (0..num_agents).map(|j| weight(i, j)).sum()).collect();
    let mut candidates: Vec<usize> = (0..num_agents).filter(|&i| degree[i] > 0.0).collect();
    candidates.sort_by(|&a, &b| degree[b].total_cmp(&degree[a]).then(a.cmp(&b)));

    let mut size = vec![0usize; num_agents];
    let mut total = vec![0.0; num_agents];
    let mut occurrences = vec![0usize; num_agents];
    for &start in &candidates {
        let mut clique = vec![start];
        for &other in candidates.iter().filter(|&&c| c != start) {
            if clique.iter().all(|&member| weight(other, member) > 0.0) {
                total[start] += clique.iter().map(|&member| weight(other, member)).sum::<f64>();
                clique.push(other);
            }
        }
        size[start] = clique.len();
        clique.iter().for_each(|&member| occurrences[member] += 1);
    }
    let first = match order {
        GreedyOrder::SizeThenWeight => size,
        GreedyOrder::Occurrences => occurrences,
    };
    let mut ranked = candidates;
    ranked.sort_by(|&a, &b| {
        Reverse(first[a]).cmp(&Reverse(first[b])).then(total[b].total_cmp(&total[a])).then(a.cmp(&b))
    });
    Ok(ranked)
}
