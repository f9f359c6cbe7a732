//! The leader: the nearest agent on the route ahead, its gap and speed.

use crate::geom::{Point2, Polyline, Pose2, Real};
use crate::state::{AgentStates, Footprint};

/// Sideways clearance that a moving obstacle must leave, metres.
const CLEARANCE_M: Real = 0.3;
/// The same for one that stands still: logged paths pass parked cars closely.
const STATIONARY_CLEARANCE_M: Real = 0.05;
/// Metres (samples of the route) from one place to the next when an agent is looked for along it.
const COARSE: usize = 4;

/// The nearest agent on the route ahead.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Leader {
    /// From bumper to bumper along the route, metres; negative where the boxes overlap.
    pub gap_m: Real,
    /// Its velocity along the route, 0 if it comes the other way, m/s.
    pub speed_mps: Real,
}

/// Time after which crossing agents are looked for unless said otherwise, seconds.
pub const ANTICIPATION_S: Real = 1.0;

/// The nearest agent, of every kind, whose box leaves too little room on the route ahead; `None` where there is none
/// within 20 m and the way of four seconds, 70 m at most.
///
/// Agents that cross count also where they will be, at constant velocity, after the anticipation time. The route has
/// points about a metre apart; `s_m` is the position along it of agent `agent_idx`.
pub fn leader(
    states: &AgentStates,
    footprints: &[Footprint],
    route: &Polyline,
    s_m: Real,
    agent_idx: usize,
    anticipation_s: Real,
) -> Option<Leader> {
    let own = &footprints[agent_idx];
    let pose = states.pose(agent_idx);
    let speed = states.speed_mps[agent_idx].max(0.0);
    let reach = (20.0 + speed * 4.0).min(70.0).min(route.length_m() - s_m);
    let window = window(route, s_m, reach);
    let [x0, x1, y0, y1] = bounds(window);
    let mut best: Option<Leader> = None;
    let places = states.x.iter().zip(&states.y).zip(&states.active);
    for (j, (((x, y), active), footprint)) in places.zip(footprints).enumerate() {
        let (dx, dy) = (x - pose.position.x, y - pose.position.y);
        let behind = dx * pose.cos + dy * pose.sin < -(own.radius_m + footprint.radius_m);
        if !active | behind | (j == agent_idx) {
            continue;
        }
        // where the agent can matter: round the window, as far as it comes while it is anticipated
        let travel = states.speed_mps[j].abs() * anticipation_s;
        let margin = own.half_width_m + footprint.radius_m + CLEARANCE_M + travel;
        if (*x < x0 - margin) | (*x > x1 + margin) | (*y < y0 - margin) | (*y > y1 + margin)
            || !states.same_level(agent_idx, j)
        {
            continue;
        }
        let crossing = (states.cos[j] * pose.cos + states.sin[j] * pose.sin).abs() < 0.8;
        let moving = states.speed_mps[j].abs() > 0.5;
        let times = [0.0, anticipation_s];
        for time_s in &times[..if crossing && moving { 2 } else { 1 }] {
            let px = states.x[j] + states.velocity_x_mps[j] * time_s;
            let py = states.y[j] + states.velocity_y_mps[j] * time_s;
            let Some((at_s, at)) = nearest_ahead(route, s_m, window, px, py) else { continue };
            let lateral = (py - at.position.y) * at.cos - (px - at.position.x) * at.sin;
            let along = (states.cos[j] * at.cos + states.sin[j] * at.sin).abs();
            let across = (states.sin[j] * at.cos - states.cos[j] * at.sin).abs();
            let half_side = across * footprint.half_length_m + along * footprint.half_width_m;
            let clearance = if moving { CLEARANCE_M } else { STATIONARY_CLEARANCE_M };
            if lateral.abs() > own.half_width_m + half_side + clearance {
                continue;
            }
            let half_ahead = along * footprint.half_length_m + across * footprint.half_width_m;
            let gap_m = at_s - s_m - own.half_length_m - half_ahead;
            if best.is_none_or(|l| gap_m < l.gap_m) {
                let v = states.velocity_x_mps[j] * at.cos + states.velocity_y_mps[j] * at.sin;
                best = Some(Leader { gap_m, speed_mps: v.max(0.0) });
            }
        }
    }
    best
}

/// Samples of a route from `s_m` on for `reach` metres; at least one.
fn window(route: &Polyline, s_m: Real, reach: Real) -> &[Point2] {
    let points = route.points();
    let first = (s_m as usize).min(points.len() - 1);
    let end_s = s_m + reach;
    // rounded up
    let last = end_s as usize + usize::from(end_s as usize as Real != end_s);
    let last = last.clamp(first, points.len() - 1);
    &points[first..=last]
}

/// Least and greatest x and y of a window; between its samples the route bends by less than a body's size.
fn bounds(window: &[Point2]) -> [Real; 4] {
    let last = window[window.len() - 1];
    window.chunks(COARSE).fold([last.x, last.x, last.y, last.y], |[x0, x1, y0, y1], samples| {
        let p = samples[0];
        // one instruction each, which `min` and `max` are not
        let (x0, x1) = (if p.x < x0 { p.x } else { x0 }, if p.x > x1 { p.x } else { x1 });
        [x0, x1, if p.y < y0 { p.y } else { y0 }, if p.y > y1 { p.y } else { y1 }]
    })
}

/// Position along the route and pose of the place ahead of `s_m` nearest to a point; `None` abreast or behind.
fn nearest_ahead(route: &Polyline, s_m: Real, window: &[Point2], x: Real, y: Real) -> Option<(Real, Pose2)> {
    let (mut least, mut best) = (Real::MAX, 0);
    for (k, samples) in window.chunks(COARSE).enumerate() {
        let (dx, dy) = (x - samples[0].x, y - samples[0].y);
        let d2 = dx * dx + dy * dy;
        // one instruction each: no branch to guess
        best = if d2 < least { k } else { best };
        least = if d2 < least { d2 } else { least };
    }
    // two steps of projection on the local tangent
    let mut at_s = (s_m as usize + best * COARSE) as Real;
    let mut at = route.at(at_s);
    for _ in 0..2 {
        let ahead = (x - at.position.x) * at.cos + (y - at.position.y) * at.sin;
        at_s = (at_s + ahead.clamp(-(COARSE as Real), COARSE as Real)).max(s_m);
        at = route.at(at_s);
    }
    (at_s > s_m + 0.1).then_some((at_s, at))
}
