//! Where an agent is in its lane, and whether it drives against traffic.

use crate::geom::Real;
use crate::scene::{LaneHit, LaneIndex};
use crate::state::AgentStates;

/// An agent that faces against the nearest lane is not on the wrong way while a lane in its own direction has its
/// centre line within this distance, metres (half a lane width).
pub const WRONG_WAY_CLEARANCE_M: Real = 2.0;

/// Relation of an agent to the lanes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LaneFacts {
    /// The nearest lane in the agent's direction, or else the nearest lane; `None` when none is in reach.
    pub lane: Option<LaneHit>,
    /// The nearest lane runs the other way (more than 90 degrees off) and no lane in the agent's direction has its
    /// centre line within [`WRONG_WAY_CLEARANCE_M`].
    pub wrong_way: bool,
}

/// Facts of one agent; lanes further than `max_distance_m` (and than the index's reach) are not seen.
#[inline]
pub fn lane_facts(
    states: &AgentStates,
    agent_idx: usize,
    lanes: &LaneIndex,
    max_distance_m: Real,
) -> LaneFacts {
    let (cos, sin) = (states.cos[agent_idx], states.sin[agent_idx]);
    let near = lanes.nearest_by_direction(states.position(agent_idx), cos, sin, max_distance_m);
    let lane = near.agreeing.or(near.any);
    let wrong_way = near.any.is_some_and(|hit| !hit.agrees())
        && near.agreeing.is_none_or(|hit| hit.distance_m > WRONG_WAY_CLEARANCE_M);
    LaneFacts { lane, wrong_way }
}
