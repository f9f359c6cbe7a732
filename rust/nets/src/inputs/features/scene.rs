//! Inputs of the agents of one scene.

use ccdiff_sim::causal::graph::CausalGraph;
use ccdiff_sim::geom::Pose2;
use ccdiff_sim::scene::{AgentKind, EGO_ID, Scene};

/// Inputs of the M agents of one scene that are there now.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneFeatures {
    /// Index in the window of each of the M agents.
    pub agents: Vec<usize>,
    /// Pose now, scene frame, [M].
    pub poses: Vec<Pose2>,
    /// Speed now, [M].
    pub speed_mps: Vec<f32>,
    /// Histories [M, H, 8], see [`super::HISTORY_FEATURES`]; zero where not available.
    pub history: Vec<f32>,
    /// Neighbour slots per agent K, at least 1. Slot 0 is the agent itself.
    pub num_slots: usize,
    /// Agent (0..M) in each slot, [M, K]; unused slots hold the agent itself.
    pub neighbours: Vec<usize>,
    /// Whether a slot is an edge to another agent, [M, K]; false for slot 0. Edges are those of G, and those to oncoming agents in
    /// one's corridor, with which the networks were trained.
    pub is_edge: Vec<bool>,
    /// Edges at the history tokens' steps, [M, K, tokens, 9], see [`super::EDGE_FEATURES`].
    pub edges: Vec<f32>,
    /// Lines of the map near each agent [M, 64, 20]; empty for a map-blind network.
    pub segments: Vec<f32>,
    /// Decision causal graph over the M agents.
    pub graph: CausalGraph,
    /// Times to contact now, seconds, [M, M].
    pub ttc_s: Vec<f32>,
    /// Seed of the agent's own noise, [M].
    pub noise_seed: Vec<Option<u64>>,
    /// Whether the agent's route is told (0 or 1), then places ahead on it in the agent's frame, x and y, [M, 1 + 2 P]; zero
    /// where it is not told. Empty for a network that knows no routes.
    pub route: Vec<f32>,
    /// Inputs of a network of tokens; empty for others.
    pub tokens: TokenInputs,
}

/// Inputs of tokens of the M agents of one scene.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TokenInputs {
    /// Yaw rate now, rad/s, [M].
    pub yaw_rate_radps: Vec<f32>,
    /// Whether speed and yaw rate are known now, [M].
    pub known: Vec<bool>,
    /// Own numbers [M, own], see [`crate::inputs::tokens::own_columns`].
    pub own: Vec<f32>,
    /// Neighbours [M, 12, 25], see [`crate::inputs::tokens::near_columns`], zero where there are fewer.
    pub near: Vec<f32>,
}

/// Logged futures of the M agents of a [`SceneFeatures`], in their agent frames.
#[derive(Debug, Clone, PartialEq)]
pub struct Futures {
    /// States x, y, v, yaw, acceleration, yaw rate, [M, T, 6]; zero where not valid.
    pub states: Vec<f32>,
    /// Whether the step is logged, [M, T].
    pub valid: Vec<bool>,
}

/// Indices of a scene's vehicles, the ego first. The network drives vehicles alone.
pub fn vehicles(scene: &Scene) -> Vec<usize> {
    let mut list: Vec<usize> = (0..scene.num_agents())
        .filter(|a| scene.agents[*a].kind == AgentKind::Vehicle || scene.agents[*a].id == EGO_ID)
        .collect();
    list.sort_by_key(|a| scene.agents[*a].id != EGO_ID);
    list
}

/// Rows of each scene of a list, counted from the first.
pub fn row_offsets(scene_sizes: &[usize]) -> Vec<usize> {
    scene_sizes
        .iter()
        .scan(0, |next, size| {
            let start = *next;
            *next += size;
            Some(start)
        })
        .collect()
}
