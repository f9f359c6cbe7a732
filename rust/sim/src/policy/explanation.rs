//! What passes between a planning policy and whoever watches or steers it.

use crate::geom::Real;
use serde::{Deserialize, Serialize};

/// Wishes for the plans of one world, in force until replaced or until the world begins a new episode.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Command {
    /// Agents of the scene to be guided, in place of the policy's own ranking; `None` leaves the choice to it.
    pub guided: Option<Vec<usize>>,
    /// Strength of the guidance in place of the configured one, at least 0.
    pub criticality: Option<Real>,
}

/// A plan of one world and what it was made from. M agents, N samples, T steps.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Explanation {
    /// Steps since the episode began when the plan was made.
    pub made_at: usize,
    /// Agents of the scene that were planned for, [M].
    pub agents: Vec<usize>,
    /// Whether the agent follows the plan, [M]; the others were predicted only.
    pub executed: Vec<bool>,
    /// Whether guidance moved the agent's plan, [M].
    pub guided: Vec<bool>,
    /// Decision causal graph G: row i looks at column j, [M, M].
    pub graph: Vec<bool>,
    /// Times to contact, seconds, [M, M].
    pub ttc_s: Vec<Real>,
    /// Attention of row i to column j, mean over heads, [M, M]; empty where it was not kept.
    pub attention: Vec<Real>,
    /// Agents of the scene by falling importance, those that may be guided only.
    pub ranking: Vec<usize>,
    /// Number of samples N.
    pub num_samples: usize,
    /// Number of steps T.
    pub num_steps: usize,
    /// Poses x, y (m), heading (rad) in the scene frame after each step, [N, M, T, 3].
    pub samples: Vec<Real>,
    /// Sample that each agent follows, [M].
    pub chosen: Vec<usize>,
    /// Names of the guidance objectives, [J].
    pub objectives: Vec<String>,
    /// Loss of each objective, sample and agent, unweighted, [J, N, M].
    pub losses: Vec<Real>,
    /// Total variation between guided and unguided actions, [M]; 0 without guidance (paper, cost C).
    pub realism_cost: Vec<Real>,
    /// Mean cosine between the gradients of objectives j and k over guided agents, [J, J]; empty where not kept.
    pub gradient_cosine: Vec<Real>,
    /// Mean cosine between the gradients of realism and guidance, [M]; 0 without a gradient, empty where not kept.
    pub realism_cosine: Vec<Real>,
    /// Share of samples and denoising steps in which that cosine is negative, [M]; empty where not kept.
    pub conflict_share: Vec<Real>,
}
