//! stub
use crate::error::Result;
use crate::geom::{Polyline, Real};
use crate::scene::{AgentKind, Map};
use crate::state::{AgentStates, Body};
use serde::{Deserialize, Serialize};
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Default)]
pub struct ObservationConfig {}
#[derive(Debug, Clone)]
pub struct Layout {
    pub size: usize,
}
impl Layout {
    pub fn new(_: &ObservationConfig) -> Result<Self> {
        Ok(Self { size: 4 })
    }
}
#[derive(Debug)]
pub struct MapPieces;
impl MapPieces {
    pub fn new(_: &Map) -> Self {
        Self
    }
}
pub struct EgoFacts {
    pub last_action: [Real; 2],
    pub speed_limit_mps: Real,
    pub lane_distance_m: Option<Real>,
    pub lateral_m: Real,
    pub heading_error_rad: Real,
    pub off_road: bool,
    pub collided: bool,
    pub route_remaining_m: Real,
    pub time_remaining: Real,
}
pub struct View<'a> {
    pub states: &'a AgentStates,
    pub bodies: &'a [Body],
    pub kinds: &'a [AgentKind],
    pub pieces: &'a MapPieces,
    pub route: &'a Polyline,
    pub route_s_m: Real,
    pub agent_idx: usize,
    pub facts: EgoFacts,
}
#[derive(Clone)]
pub struct Observer;
impl Observer {
    pub fn new(_: Layout, _: usize) -> Self {
        Self
    }
    pub fn write(&mut self, v: &View<'_>, out: &mut [Real]) {
        out[0] = v.states.x[v.agent_idx];
        out[1] = v.states.y[v.agent_idx];
        out[2] = v.states.speed_mps[v.agent_idx];
        out[3] = v.facts.time_remaining;
    }
}
