//! Where an agent is: beside others, its route, lanes, the road, its log.

use crate::events::{self, lane_facts, off_road};
use crate::geom::{Real, math};
use crate::observe::RoutePlace;
use crate::stage::PreparedScene;
use crate::state::AgentStates;
use crate::world::episode::{Episode, Slot};

/// Lanes farther than this say nothing about an agent, metres.
const LANE_REACH_M: Real = 5.0;

/// Finds an agent beside its route, at a place along it, and beside the lanes; with it, the distance from that place, metres.
pub fn place_on_route(
    states: &AgentStates,
    scene: &PreparedScene,
    a: usize,
    s_m: Real,
    speed_limit_mps: Real,
) -> (RoutePlace, Real) {
    let pose = states.pose(a);
    let on_route = scene.routes[a].path.at(s_m);
    let d = pose.position - on_route.position;
    let cos = pose.cos * on_route.cos + pose.sin * on_route.sin;
    let sin = pose.sin * on_route.cos - pose.cos * on_route.sin;
    let map = &scene.scene.map;
    let lanes = scene.at(states.elevation_m(a)).lanes.as_ref();
    let lane = lanes.map(|l| lane_facts(states, a, l, map, LANE_REACH_M)).unwrap_or_default();
    let limit = lane.lane.zip(lanes).and_then(|(lane, lanes)| lanes.speed_limit_mps(lane.lane_idx));
    let place = RoutePlace {
        wrong_way: lane.wrong_way,
        route_distance_m: d.y * on_route.cos - d.x * on_route.sin,
        heading_error_rad: math::atan2(sin, cos),
        lane_distance_m: lane.lane.map(|l| l.distance_m),
        speed_limit_mps: limit.unwrap_or(speed_limit_mps),
    };
    (place, d.norm())
}

/// Whether an agent straddles lanes or is beside them; never where the map has none.
pub(crate) fn straddles_lanes(states: &AgentStates, scene: &PreparedScene, a: usize) -> bool {
    let corners = || states.oriented_box(a, &scene.footprints[a]).corners();
    let lanes = scene.at(states.elevation_m(a)).lanes.as_ref();
    lanes.is_some_and(|lanes| events::straddles_lanes(lanes, &scene.scene.map, &corners()))
}

/// Tells a slot whether its agent is off the road, or was at an earlier part of the step.
pub(crate) fn leave_road(states: &AgentStates, scene: &PreparedScene, a: usize, slot: &mut Slot) {
    if let Some(road) = &scene.at(states.elevation_m(a)).road {
        let off = off_road(states, a, &scene.footprints[a], road);
        slot.has_been_on_road |= !off.corner;
        slot.off_road |= off.corner && slot.has_been_on_road;
        slot.off_road_centroid |= off.centroid && slot.has_been_on_road;
    }
}

/// Distance of an agent from its log, metres; 0 where there is none.
pub(crate) fn log_distance(e: &Episode, scene: &PreparedScene, a: usize) -> Real {
    let logged = scene.log.position(a, e.step_idx);
    logged.map_or(0.0, |p| (e.states.position(a) - p).norm())
}
