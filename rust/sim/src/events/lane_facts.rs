//! Where an agent is in its lane, whether it drives against traffic, and whether it straddles lanes.

use crate::geom::{Point2, Real};
use crate::scene::{LaneHit, LaneIndex, LaneKind, Map};
use crate::state::AgentStates;

/// Relation of an agent to the lanes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LaneFacts {
    /// The nearest lane in the agent's direction, or else the nearest lane; `None` when none is in reach.
    pub lane: Option<LaneHit>,
    /// The surface of a lane holds the agent's centre, and the agent faces against it and any other such lane, more than
    /// 90 degrees off. Connectors through intersections say nothing.
    pub wrong_way: bool,
}

/// Facts of one agent; lanes further than `max_distance_m` (and than the index's reach) are not seen as the nearest.
#[inline]
pub fn lane_facts(
    states: &AgentStates,
    agent_idx: usize,
    lanes: &LaneIndex,
    map: &Map,
    max_distance_m: Real,
) -> LaneFacts {
    let (point, cos, sin) = (states.position(agent_idx), states.cos[agent_idx], states.sin[agent_idx]);
    let near = lanes.nearest_by_direction(point, cos, sin, max_distance_m);
    let wrong_way = near.any.is_some_and(|_| {
        let agrees = |lane_idx: usize| {
            let is_it = |hit: &LaneHit| hit.lane_idx as usize == lane_idx;
            let on_lane = || near.any.filter(is_it).or_else(|| lanes.on_lane(lane_idx, point, cos, sin));
            near.agreeing.as_ref().is_some_and(is_it) || on_lane().is_some_and(|hit| hit.agrees())
        };
        lanes.all_against(map, point, (cos, sin), agrees)
    });
    LaneFacts { lane: near.agreeing.or(near.any), wrong_way }
}

/// Lanes, connectors left out, whose surface holds a point.
fn proper_lanes<'a>(lanes: &'a LaneIndex, map: &'a Map, point: Point2) -> impl Iterator<Item = usize> + 'a {
    lanes.holding(map, point).filter(|lane_idx| map.lanes[*lane_idx].kind == LaneKind::Lane)
}

/// The lane that holds a point: the former one while it does, else of several the one whose centre line is nearest.
/// Connectors through intersections are none.
pub fn lane_that_holds(
    lanes: &LaneIndex,
    map: &Map,
    point: Point2,
    before: Option<usize>,
) -> Option<LaneHit> {
    let on = |lane_idx: usize| lanes.on_lane(lane_idx, point, 1.0, 0.0);
    if let Some(hit) = before.filter(|lane_idx| lanes.holds(map, *lane_idx, point)).and_then(on) {
        return Some(hit);
    }
    let found = proper_lanes(lanes, map, point).filter_map(on);
    found.min_by(|a, b| a.distance_m.total_cmp(&b.distance_m))
}

/// Whether a point is in an intersection, which is where connectors are.
pub fn in_intersection(lanes: &LaneIndex, map: &Map, point: Point2) -> bool {
    lanes.holding(map, point).any(|lane_idx| map.lanes[lane_idx].kind == LaneKind::Connector)
}

/// Whether an agent is in several lanes or beside them: its corners, counter-clockwise from the front left, are neither
/// all in one lane or connector, nor in ones that follow one another.
///
/// The rule by which nuPlan tells a change of lanes (`ego_lane_change`), but that it looks at one moment alone.
pub fn straddles_lanes(lanes: &LaneIndex, map: &Map, corners: &[Point2; 4]) -> bool {
    let places = corners.map(|corner| Place::new(lanes, map, corner));
    let [front_left, rear_left, rear_right, front_right] = &places;
    if front_left.lanes().any(|l| places.iter().all(|place| place.is_in(l))) {
        return false;
    }
    let successors = |l: usize| map.lanes[l].successors.iter().map(|s| *s as usize);
    let predecessors = |l: usize| map.lanes[l].predecessors.iter().map(|p| *p as usize);
    // a place is in a lane or in one that leads there, or in one or in one that follows
    let reached = |place: &Place<'_>, l: usize| place.is_in(l) || predecessors(l).any(|p| place.is_in(p));
    let left = |place: &Place<'_>, l: usize| place.is_in(l) || successors(l).any(|s| place.is_in(s));
    let rear_agrees = rear_left.lanes().any(|l| reached(rear_right, l))
        || rear_right.lanes().any(|l| reached(rear_left, l));
    let joins = |l: usize| {
        left(front_left, l) && left(front_right, l) && reached(rear_left, l) && reached(rear_right, l)
    };
    !(rear_agrees && front_left.lanes().any(|l| joins(l) || predecessors(l).any(joins)))
}

/// The lanes at a point: proper ones, and connectors where there is none of them.
struct Place<'a> {
    lanes: &'a LaneIndex,
    map: &'a Map,
    point: Point2,
    has_lane: bool,
}

impl<'a> Place<'a> {
    fn new(lanes: &'a LaneIndex, map: &'a Map, point: Point2) -> Self {
        Self { lanes, map, point, has_lane: proper_lanes(lanes, map, point).next().is_some() }
    }

    fn counts(&self, lane_idx: usize) -> bool {
        !self.has_lane || self.map.lanes[lane_idx].kind == LaneKind::Lane
    }

    fn lanes(&self) -> impl Iterator<Item = usize> + '_ {
        self.lanes.holding(self.map, self.point).filter(|l| self.counts(*l))
    }

    fn is_in(&self, lane_idx: usize) -> bool {
        self.counts(lane_idx) && self.lanes.holds(self.map, lane_idx, self.point)
    }
}
