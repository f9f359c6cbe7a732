//! The table of columns: what each number of a row means and how it is computed. A new column is one entry here.

use super::column::{Axis, ObservationColumn};
use super::map_segments::SegmentKind;
use super::source::{OfAgent, OfEgo, OfSegment, ROAD_REACH_M};
use crate::events::{Leader, time_to_contact};
use crate::geom::Real;
use crate::scene::{AgentKind, LightState};
use OfAgent::{Direction, Fixed, OnRoute, Pair, Place, Speed, Velocity};
use std::f32::consts::{FRAC_PI_2, FRAC_PI_6};

/// A column and where its quantity comes from.
#[derive(Debug, Clone)]
pub(super) struct Entry<S> {
    pub(super) column: ObservationColumn,
    pub(super) source: S,
}

const fn entry<S: Copy>(
    name: &'static str,
    unit: &'static str,
    scale: Real,
    [low, high]: [Real; 2],
    doc: &'static str,
    source: S,
) -> Entry<S> {
    Entry { column: ObservationColumn { name, unit, scale, low, high, doc, in_default: true }, source }
}

/// A column that rows have only where it is asked for by name.
const fn on_request<S: Copy>(entry: Entry<S>) -> Entry<S> {
    Entry { column: ObservationColumn { in_default: false, ..entry.column }, source: entry.source }
}

/// A column about the next light along the route.
const fn light(
    name: &'static str,
    unit: &'static str,
    scale: Real,
    doc: &'static str,
    source: OfEgo,
) -> Entry<OfEgo> {
    on_request(entry(name, unit, scale, POSITIVE, doc, source))
}

/// A column about the road that is free from the centre on.
const fn road(name: &'static str, doc: &'static str, source: OfEgo) -> Entry<OfEgo> {
    on_request(entry(name, "m", ROAD_REACH_M, POSITIVE, doc, source))
}

/// Bounds of numbers of either sign, and of numbers that are not negative.
const SIGNED: [Real; 2] = [-1.0, 1.0];
const POSITIVE: [Real; 2] = [0.0, 1.0];

/// Times that divide ways are at least this, seconds, and ways that divide speeds, metres.
const LEAST_TIME_S: Real = 0.1;
const LEAST_WAY_M: Real = 0.1;
/// Room that braking leaves to a leader, metres.
const LEADER_ROOM_M: Real = 2.0;

/// Deceleration from one speed to another within a way, m/s².
fn braking(from_mps: Real, to_mps: Real, way_m: Real) -> Real {
    (from_mps * from_mps - to_mps * to_mps).max(0.0) / (2.0 * way_m.max(LEAST_WAY_M))
}

/// Time to contact counts up to here, seconds.
const TTC_SCALE_S: Real = 10.0;

pub(super) static EGO: &[Entry<OfEgo>] = &[
    entry("speed", "m/s", 20.0, SIGNED, "along the heading", |e| e.state(|s| &s.speed_mps)),
    entry("acceleration", "m/s2", 10.0, SIGNED, "change of speed over the last step", |e| {
        e.state(|s| &s.acceleration_mps2)
    }),
    entry("yaw_rate", "rad/s", 1.0, SIGNED, "change of heading over the last step", |e| {
        e.state(|s| &s.yaw_rate_radps)
    }),
    entry("length", "m", 10.0, POSITIVE, "of the box", |e| 2.0 * e.footprint().half_length_m),
    on_request(entry("width", "m", 4.0, POSITIVE, "of the box", |e| 2.0 * e.footprint().half_width_m)),
    entry("last_action_0", "", 1.0, SIGNED, "first column of the last normalised action", |e| {
        e.view.facts.last_action[0]
    }),
    entry("last_action_1", "", 1.0, SIGNED, "second column of the last normalised action", |e| {
        e.view.facts.last_action[1]
    }),
    entry("speed_limit", "m/s", 20.0, POSITIVE, "of the lane, else the configured one", |e| {
        e.view.facts.place.speed_limit_mps
    }),
    entry(
        "route_distance",
        "m",
        5.0,
        SIGNED,
        "offset across the route at its tracked place, left positive",
        |e| e.view.facts.place.route_distance_m,
    ),
    entry("route_sin", "", 1.0, SIGNED, "sine of the heading against the route", |e| e.route_turn().0),
    entry("route_cos", "", 1.0, SIGNED, "cosine of the heading against the route", |e| e.route_turn().1),
    on_request(entry("has_lane", "", 1.0, POSITIVE, "1 if a lane is near", |e| {
        Real::from(e.view.facts.place.lane_distance_m.is_some())
    })),
    on_request(entry(
        "lane_distance",
        "m",
        5.0,
        POSITIVE,
        "to the nearest lane centre, those of its direction first; 0 without one",
        |e| e.view.facts.place.lane_distance_m.unwrap_or(0.0),
    )),
    entry("off_road", "", 1.0, POSITIVE, "1 if a corner of the box is off the road", |e| {
        Real::from(e.view.facts.off_road)
    }),
    on_request(entry("collided", "", 1.0, POSITIVE, "1 while touching another agent", |e| {
        Real::from(e.view.facts.collided)
    })),
    entry("route_remaining", "m", 100.0, POSITIVE, "along the route to the goal", |e| {
        e.view.facts.route_remaining_m
    }),
    entry("goal_near", "m", 10.0, SIGNED, "along the route to the goal, negative past it", |e| {
        e.view.facts.goal_ahead_m
    }),
    entry("time_remaining", "", 1.0, POSITIVE, "share of the episode that is left", |e| {
        e.view.facts.time_remaining
    }),
    entry(
        "goal_speed",
        "m/s",
        20.0,
        POSITIVE,
        "of the log at the goal, 0 where it stands there, 1 once it is reached",
        |e| e.view.facts.goal_speed_mps,
    ),
    entry("pace", "m/s", 20.0, POSITIVE, "mean speed that reaches the goal in the time that is left", |e| {
        e.view.facts.goal_ahead_m / e.view.facts.time_left_s.max(LEAST_TIME_S)
    }),
    entry(
        "goal_braking",
        "m/s2",
        10.0,
        POSITIVE,
        "constant deceleration that passes the goal as fast as the log",
        |e| {
            let (facts, speed) = (e.view.facts, e.state(|s| &s.speed_mps).max(0.0));
            braking(speed, facts.goal_speed_mps, facts.goal_ahead_m)
        },
    ),
    entry(
        "leader_gap",
        "m",
        60.0,
        POSITIVE,
        "bumper to bumper to the next agent on the route, 1: none near",
        |e| e.leader().map_or(Real::MAX, |l| l.gap_m),
    ),
    entry(
        "leader_closing",
        "m/s",
        20.0,
        SIGNED,
        "speed less the speed of that agent along the route, 0 without one",
        |e| e.leader().map_or(0.0, |l| e.state(|s| &s.speed_mps) - l.speed_mps),
    ),
    entry("leader_near", "m", 10.0, POSITIVE, "the gap once more, 1: 10 m or more", |e| {
        e.leader().map_or(Real::MAX, |l| l.gap_m)
    }),
    entry(
        "leader_braking",
        "m/s2",
        10.0,
        POSITIVE,
        "constant deceleration that stays 2 m behind that agent at its present speed, 0 without one",
        |e| {
            let closing = |l: Leader| (e.state(|s| &s.speed_mps) - l.speed_mps).max(0.0);
            e.leader().map_or(0.0, |l| braking(closing(l), 0.0, l.gap_m - LEADER_ROOM_M))
        },
    ),
    light("light_green", "", 1.0, "1 if the next light along the route is green", |e| {
        e.shows(LightState::Green)
    }),
    light("light_yellow", "", 1.0, "1 if it is yellow", |e| e.shows(LightState::Yellow)),
    light("light_red", "", 1.0, "1 if it is red", |e| e.shows(LightState::Red)),
    light("light_distance", "m", 60.0, "from the front to its stop line, 1: none near", |e| {
        e.light().map_or(Real::MAX, |l| l.gap_m)
    }),
    light("light_since", "s", 30.0, "since its state changed, or the log began", |e| {
        e.light().map_or(0.0, |l| l.since_s)
    }),
    light(
        "light_braking",
        "m/s2",
        10.0,
        "constant deceleration that stops at its line, 0 unless it is red",
        |e| {
            let red = e.light().filter(|l| l.state == LightState::Red);
            red.map_or(0.0, |l| braking(e.state(|s| &s.speed_mps).max(0.0), 0.0, l.gap_m))
        },
    ),
    road("road_left", "free road to the left", |e| e.road_m(FRAC_PI_2)),
    road("road_front_left", "free road 30 degrees to the left", |e| e.road_m(FRAC_PI_6)),
    road("road_front", "free road ahead", |e| e.road_m(0.0)),
    road("road_front_right", "free road 30 degrees to the right", |e| e.road_m(-FRAC_PI_6)),
    road("road_right", "free road to the right", |e| e.road_m(-FRAC_PI_2)),
];

/// Columns of `route`: place and direction of a point, turned into the frame together.
pub(super) const ROUTE: [Entry<()>; 4] = [
    entry("x", "m", 60.0, SIGNED, "ahead", ()),
    entry("y", "m", 60.0, SIGNED, "to the left", ()),
    entry("cos", "", 1.0, SIGNED, "cosine of the direction", ()),
    entry("sin", "", 1.0, SIGNED, "sine of the direction", ()),
];

macro_rules! of_kind {
    ($name:literal, $kind:ident) => {
        entry($name, "", 1.0, POSITIVE, "kind", Fixed(|_, kind| Real::from(kind == AgentKind::$kind)))
    };
}

pub(super) static AGENTS: &[Entry<OfAgent>] = &[
    entry("x", "m", 60.0, SIGNED, "centre, ahead", Place(Axis::X)),
    entry("y", "m", 60.0, SIGNED, "centre, to the left", Place(Axis::Y)),
    entry("cos", "", 1.0, SIGNED, "cosine of the heading", Direction(Axis::X)),
    entry("sin", "", 1.0, SIGNED, "sine of the heading", Direction(Axis::Y)),
    entry("velocity_x", "m/s", 20.0, SIGNED, "velocity relative to the observer's, ahead", Velocity(Axis::X)),
    entry(
        "velocity_y",
        "m/s",
        20.0,
        SIGNED,
        "velocity relative to the observer's, to the left",
        Velocity(Axis::Y),
    ),
    entry("speed", "m/s", 20.0, SIGNED, "along its own heading", Speed),
    entry("length", "m", 10.0, POSITIVE, "of the box", Fixed(|footprint, _| 2.0 * footprint.half_length_m)),
    entry("width", "m", 4.0, POSITIVE, "of the box", Fixed(|footprint, _| 2.0 * footprint.half_width_m)),
    on_request(entry(
        "distance",
        "m",
        60.0,
        POSITIVE,
        "between centres",
        Pair(|all, to| all.each(to, |p| p.distance_m())),
    )),
    entry(
        "ttc",
        "s",
        TTC_SCALE_S,
        POSITIVE,
        "time to contact at constant velocities, 1: none",
        Pair(|all, to| {
            all.each(to, |p| {
                let v = p.view;
                time_to_contact(v.states, v.footprints, v.agent_idx, p.other, TTC_SCALE_S)
                    .unwrap_or(Real::MAX)
            });
        }),
    ),
    of_kind!("is_vehicle", Vehicle),
    on_request(of_kind!("is_pedestrian", Pedestrian)),
    on_request(of_kind!("is_cyclist", Cyclist)),
    on_request(of_kind!("is_motorcycle", Motorcycle)),
    on_request(of_kind!("is_static", Static)),
    entry(
        "route_position",
        "m",
        60.0,
        SIGNED,
        "along the observer's route, from the observer on",
        OnRoute(|all, to| all.each_on_route(to, |p, place| place.s_m - p.view.route_s_m)),
    ),
    entry(
        "route_distance",
        "m",
        10.0,
        SIGNED,
        "signed distance from that route, left positive",
        OnRoute(|all, to| all.each_on_route(to, |_, place| place.lateral_m)),
    ),
    entry(
        "route_speed",
        "m/s",
        20.0,
        SIGNED,
        "velocity along that route, at the nearest place",
        OnRoute(|all, to| {
            all.each_on_route(to, |p, place| {
                let (v, along) = (p.velocity(), p.view.route.tangent_at(place.s_m));
                v.x * along.x + v.y * along.y
            });
        }),
    ),
    on_request(entry(
        "acceleration",
        "m/s2",
        10.0,
        SIGNED,
        "change of its speed over the last step",
        Pair(|all, to| all.each(to, |p| p.view.states.acceleration_mps2[p.other])),
    )),
    on_request(entry(
        "yaw_rate",
        "rad/s",
        1.0,
        SIGNED,
        "change of its heading over the last step",
        Pair(|all, to| all.each(to, |p| p.view.states.yaw_rate_radps[p.other])),
    )),
];

pub(super) static MAP: &[Entry<OfSegment>] = &[
    entry("x", "m", 60.0, SIGNED, "middle of the piece, ahead", OfSegment::Place(Axis::X)),
    entry("y", "m", 60.0, SIGNED, "middle of the piece, to the left", OfSegment::Place(Axis::Y)),
    entry("cos", "", 1.0, SIGNED, "cosine of its direction", OfSegment::Direction(Axis::X)),
    entry("sin", "", 1.0, SIGNED, "sine of its direction", OfSegment::Direction(Axis::Y)),
    entry("half_length", "m", 5.0, POSITIVE, "half its length", OfSegment::HalfLength),
    kind("is_lane", "centre line of a lane", SegmentKind::Lane),
    kind("is_connector", "centre line of a lane connector", SegmentKind::Connector),
    kind("is_road_divider", "line between directions", SegmentKind::RoadDivider),
    kind("is_lane_divider", "line between lanes", SegmentKind::LaneDivider),
    kind("is_road_edge", "edge of the drivable area", SegmentKind::RoadEdge),
    kind("is_crossing", "edge of a pedestrian crossing", SegmentKind::Crossing),
    kind("is_stop_line", "edge of a stop line area", SegmentKind::StopLine),
    kind("is_walkway", "edge of a walkway", SegmentKind::Walkway),
];

const fn kind(name: &'static str, doc: &'static str, kind: SegmentKind) -> Entry<OfSegment> {
    entry(name, "", 1.0, POSITIVE, doc, OfSegment::Is(kind))
}
