//! Where an agent is: beside others, its route, lanes, the road, its log.

use crate::events::{self, lane_facts, off_road};
use crate::geom::{Real, math};
use crate::stage::PreparedScene;
use crate::state::AgentStates;
use crate::world::config::WorldConfig;
use crate::world::episode::{Episode, Slot};

/// Lanes farther than this say nothing about an agent, metres.
const LANE_REACH_M: Real = 5.0;

/// Where an agent is beside its route and lanes.
pub(crate) struct OnRoute {
    /// Distance from the route's place, and the part of it across the route, left positive, metres.
    pub(crate) from_route_m: Real,
    pub(crate) distance_m: Real,
    /// Heading against the route, radians.
    pub(crate) heading_error_rad: Real,
    /// Distance to the nearest lane centre, metres, where a lane is near.
    pub(crate) lane_distance_m: Option<Real>,
    /// Limit of that lane, m/s, where the map has one.
    pub(crate) speed_limit_mps: Option<Real>,
    pub(crate) wrong_way: bool,
}

/// Finds an agent beside its route, at a place along it, and beside the lanes.
pub(crate) fn place_on_route(states: &AgentStates, scene: &PreparedScene, a: usize, s_m: Real) -> OnRoute {
    let pose = states.pose(a);
    let on_route = scene.routes[a].path.at(s_m);
    let d = pose.position - on_route.position;
    let cos = pose.cos * on_route.cos + pose.sin * on_route.sin;
    let sin = pose.sin * on_route.cos - pose.cos * on_route.sin;
    let map = &scene.scene.map;
    let lanes = scene.at(states.elevation_m(a)).lanes.as_ref();
    let lane = lanes.map(|l| lane_facts(states, a, l, map, LANE_REACH_M)).unwrap_or_default();
    OnRoute {
        from_route_m: d.norm(),
        distance_m: d.y * on_route.cos - d.x * on_route.sin,
        heading_error_rad: math::atan2(sin, cos),
        lane_distance_m: lane.lane.map(|l| l.distance_m),
        speed_limit_mps: lane.lane.zip(lanes).and_then(|(lane, lanes)| lanes.speed_limit_mps(lane.lane_idx)),
        wrong_way: lane.wrong_way,
    }
}

/// Whether an agent straddles lanes or is beside them; never where the map has none.
pub(crate) fn straddles_lanes(states: &AgentStates, scene: &PreparedScene, a: usize) -> bool {
    let corners = || states.oriented_box(a, &scene.footprints[a]).corners();
    let lanes = scene.at(states.elevation_m(a)).lanes.as_ref();
    lanes.is_some_and(|lanes| events::straddles_lanes(lanes, &scene.scene.map, &corners()))
}

/// Tells a slot where its agent is beside route and lane; returns the distance from the route's place, metres.
pub(crate) fn route_and_lane(
    states: &AgentStates,
    scene: &PreparedScene,
    a: usize,
    route_s_m: Real,
    slot: &mut Slot,
    config: &WorldConfig,
) -> Real {
    let place = place_on_route(states, scene, a, route_s_m);
    slot.route_distance_m = place.distance_m;
    slot.route_heading_error_rad = place.heading_error_rad;
    slot.lane_distance_m = place.lane_distance_m;
    slot.wrong_way = place.wrong_way;
    slot.speed_limit_mps = place.speed_limit_mps.unwrap_or(config.speed_limit_mps);
    place.from_route_m
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
