//! The paper's greedy cliques on the graph G = M x attention.

use crate::error::{Result, SimError, check_length};
use crate::geom::Real;

/// Orders the agents by the cliques grown greedily from each of them, by size, then weight; others are tried by falling
/// weighted degree. `weights` [M, M] is G times attention, at least 0; its diagonal is ignored.
///
/// Differs from the paper (algorithm "Causal discovery and Ranking"): it leaves open the order of the vertices, the
/// symmetrisation and ties; here the weight of a pair is the larger of its two directions, and ties go to the smaller
/// index (reference.md#greedy-cliques).
pub(super) fn greedy_order(num_agents: usize, weights: &[Real]) -> Result<Vec<usize>> {
    check_length("weights of the graph", weights.len(), num_agents * num_agents)?;
    if let Some(bad) = weights.iter().find(|w| !w.is_finite() || **w < 0.0) {
        return Err(SimError::config("rank.weights", bad, "finite and at least 0"));
    }
    let weight = |i: usize, j: usize| {
        let pair = weights[i * num_agents + j].max(weights[j * num_agents + i]);
        if i == j { 0.0 } else { f64::from(pair) }
    };
    let degree: Vec<f64> = (0..num_agents).map(|i| (0..num_agents).map(|j| weight(i, j)).sum()).collect();
    let mut candidates: Vec<usize> = (0..num_agents).filter(|&i| degree[i] > 0.0).collect();
    candidates.sort_by(|&a, &b| degree[b].total_cmp(&degree[a]).then(a.cmp(&b)));
    let grown = |&start: &usize| {
        let (mut clique, mut total) = (vec![start], 0.0);
        for &other in candidates.iter().filter(|&&c| c != start) {
            if clique.iter().all(|&member| weight(other, member) > 0.0) {
                total += clique.iter().map(|&member| weight(other, member)).sum::<f64>();
                clique.push(other);
            }
        }
        (start, clique.len(), total)
    };
    let mut ranked: Vec<(usize, usize, f64)> = candidates.iter().map(grown).collect();
    ranked.sort_by(|a, b| b.1.cmp(&a.1).then(b.2.total_cmp(&a.2)).then(a.0.cmp(&b.0)));
    Ok(ranked.into_iter().map(|(agent, ..)| agent).collect())
}
