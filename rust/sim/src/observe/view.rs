//! What a row is written from: the states of a world and facts about the observing agent.

use super::map_segments::MapSegments;
use crate::geom::{Polyline, Real, Region};
use crate::scene::{AgentKind, LightAlong, Map};
use crate::state::{AgentStates, Footprint};
use serde::{Deserialize, Serialize};

/// Where an agent is beside its route and lanes.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct RoutePlace {
    /// It faces against the lane whose surface holds it.
    pub wrong_way: bool,
    /// Offset across the direction of the route at the agent's place along it, left positive, metres.
    pub route_distance_m: Real,
    /// Heading against the route, radians.
    pub heading_error_rad: Real,
    /// Distance to the nearest lane centre, lanes of the agent's direction first, metres, where a lane is near.
    pub lane_distance_m: Option<Real>,
    /// Speed limit of that lane, else the configured one, m/s.
    pub speed_limit_mps: Real,
}

/// What the world knows about the observing agent beside its state.
#[derive(Debug, Clone, Copy)]
pub struct EgoFacts {
    /// First two columns of the last normalised action.
    pub last_action: [Real; 2],
    /// Where it is beside route and lanes.
    pub place: RoutePlace,
    /// A corner is off the road.
    pub off_road: bool,
    /// Touches another agent.
    pub collided: bool,
    /// Distance along the route to the goal, metres.
    pub route_remaining_m: Real,
    /// The same where the goal may lie behind, negative then, and 0 once it is reached.
    pub goal_ahead_m: Real,
    /// Share of the episode that is left.
    pub time_remaining: Real,
    /// The same in seconds.
    pub time_left_s: Real,
    /// Speed of the log at the goal, 0 where it stands there, m/s.
    pub goal_speed_mps: Real,
}

/// Everything an observation is made from.
#[derive(Debug, Clone, Copy)]
pub struct View<'a> {
    /// States of all agents.
    pub states: &'a AgentStates,
    /// Their footprints.
    pub footprints: &'a [Footprint],
    /// Their kinds.
    pub kinds: &'a [AgentKind],
    /// The map.
    pub segments: &'a MapSegments,
    /// The same with its lights.
    pub map: &'a Map,
    /// The drivable area at the agent's level, where the map has one.
    pub road: Option<&'a Region>,
    /// Lights along the route, nearest first.
    pub lights: &'a [LightAlong],
    /// Step of the log.
    pub step_idx: usize,
    /// Length of a step, seconds.
    pub dt_s: Real,
    /// Route of the observing agent.
    pub route: &'a Polyline,
    /// Its position along the route, metres.
    pub route_s_m: Real,
    /// The observing agent.
    pub agent_idx: usize,
    /// Facts about it.
    pub facts: EgoFacts,
}
