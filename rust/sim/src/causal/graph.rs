//! The decision causal graph G: which agents may influence which decisions.

use crate::error::{Result, SimError, check_length};
use crate::geom::Real;

/// When two agents are joined.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GraphThresholds {
    /// Joined only if the time to contact is at most this, seconds.
    pub ttc_s: Real,
    /// Joined only if the distance of the centres is at most this, metres.
    pub distance_m: Real,
}

impl GraphThresholds {
    /// The paper's table of hyper-parameters.
    pub const PAPER: Self = Self { ttc_s: 3.0, distance_m: 50.0 };
}

/// A directed graph over M agents with all self loops; entry (i, j) says that j may influence i.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CausalGraph {
    num_agents: usize,
    is_edge: Vec<bool>,
}

impl CausalGraph {
    /// Joins pairs whose time to contact and distance [M, M] both lie within the thresholds, and every agent with itself.
    ///
    /// # Errors
    /// [`SimError::Length`] for a matrix that is not M * M, [`SimError::Config`] for a threshold that is negative
    /// or not a number.
    ///
    /// # Reference
    /// Paper, section on the causal scene encoder; thresholds in physical units (reference.md#open-points).
    pub fn from_measures(
        num_agents: usize,
        ttc_s: &[Real],
        distance_m: &[Real],
        thresholds: GraphThresholds,
    ) -> Result<Self> {
        check_length("TTC matrix", ttc_s.len(), num_agents * num_agents)?;
        check_length("distance matrix", distance_m.len(), num_agents * num_agents)?;
        for (field, value) in [("graph.ttc_s", thresholds.ttc_s), ("graph.distance_m", thresholds.distance_m)]
        {
            if value.is_nan() || value < 0.0 {
                return Err(SimError::config(field, value, "at least 0"));
            }
        }
        let near = |k: usize| ttc_s[k] <= thresholds.ttc_s && distance_m[k] <= thresholds.distance_m;
        let is_self = |k: usize| k.is_multiple_of(num_agents + 1);
        let is_edge = (0..num_agents * num_agents).map(|k| is_self(k) || near(k)).collect();
        Ok(Self { num_agents, is_edge })
    }

    /// Number of agents M.
    pub fn num_agents(&self) -> usize {
        self.num_agents
    }

    /// All entries [M, M], row-major.
    pub fn as_slice(&self) -> &[bool] {
        &self.is_edge
    }

    /// Whether j may influence i.
    pub fn contains(&self, i: usize, j: usize) -> bool {
        self.is_edge[i * self.num_agents + j]
    }

    /// G times attention [M, M]: the attention of row i to column j where they are joined, else 0; 1 in place of the
    /// attention where there is none.
    pub fn weights(&self, attention: Option<&[Real]>) -> Vec<Real> {
        let weight = |k: usize| attention.map_or(1.0, |a| a[k]);
        self.is_edge.iter().enumerate().map(|(k, joined)| if *joined { weight(k) } else { 0.0 }).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn graph_joins_within_both_thresholds_and_always_self() {
        let ttc_s = [0.0, 3.0, 1.0, 3.1, 0.0, 20.0, 1.0, 20.0, 0.0];
        let distance_m = [0.0, 50.0, 51.0, 50.0, 0.0, 5.0, 51.0, 5.0, Real::INFINITY];
        let joined = |thresholds| CausalGraph::from_measures(3, &ttc_s, &distance_m, thresholds);
        let graph = joined(GraphThresholds::PAPER).unwrap();
        assert_eq!(graph.as_slice(), [true, true, false, false, true, false, false, false, true]);
        assert!(joined(GraphThresholds { ttc_s: -1.0, ..GraphThresholds::PAPER }).is_err());
    }
}
