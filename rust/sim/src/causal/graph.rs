//! The decision causal graph G: who may influence whose decision.

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
    /// Joins pairs whose time to contact and distance both lie within the thresholds, and every agent with itself.
    ///
    /// # Shapes
    /// `ttc_s`, `distance_m`: [M, M].
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
        let pairs = num_agents * num_agents;
        for (what, got) in [("TTC matrix", ttc_s.len()), ("distance matrix", distance_m.len())] {
            check_length(what, got, pairs)?;
        }
        for (field, value) in [("graph.ttc_s", thresholds.ttc_s), ("graph.distance_m", thresholds.distance_m)]
        {
            if value.is_nan() || value < 0.0 {
                return Err(SimError::config(field, value, "at least 0"));
            }
        }
        let mut is_edge: Vec<bool> = ttc_s
            .iter()
            .zip(distance_m)
            .map(|(&t, &d)| t <= thresholds.ttc_s && d <= thresholds.distance_m)
            .collect();
        for i in 0..num_agents {
            is_edge[i * num_agents + i] = true;
        }
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

    /// Whether j may influence i; false for indices out of range.
    pub fn contains(&self, i: usize, j: usize) -> bool {
        j < self.num_agents && self.is_edge.get(i * self.num_agents + j).copied().unwrap_or(false)
    }
}
