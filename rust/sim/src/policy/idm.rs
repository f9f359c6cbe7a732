//! The intelligent driver model along a route (Treiber, Hennecke, Helbing 2000, Phys. Rev. E 62).
//!
//! a = a_max · (1 − (v / v₀)^δ − (s* / gap)²),  s* = s₀ + max(0, v·T + v·Δv / (2·√(a_max·b))).
//!
//! The leader is whoever stands on the route ahead, of every kind of agent; crossing agents count also where they
//! will be, at constant velocity, after the anticipation time. v₀ is the agent's own greatest logged speed, at most
//! the speed limit and what the curves ahead allow. Vehicles that never move in the log stay parked.

use super::{BackgroundPolicy, Motion, WorldView};
use crate::geom::{Point2, Pose2, Real, Vector2, math};
use crate::world::{IdmConfig, Route};

/// Sideways clearance that a moving obstacle must leave, metres.
const CLEARANCE_M: Real = 0.3;
/// The same for one that stands still: logged paths pass parked cars closely.
const STANDING_CLEARANCE_M: Real = 0.05;
/// Desired speed of a vehicle whose log is slower than this, m/s.
const MIN_DESIRED_MPS: Real = 4.0;
/// Metres (samples of the route) from one place to the next when an agent is looked for along it.
const COARSE: usize = 4;

/// Follows the agent's route and keeps its distance.
#[derive(Debug, Default)]
pub struct Idm;

/// The nearest thing on the route.
#[derive(Debug, Clone, Copy)]
struct Leader {
    gap_m: Real,
    speed_mps: Real,
}

/// Acceleration of the model, m/s², between −`max_braking` and `acceleration`.
fn acceleration(idm: &IdmConfig, speed: Real, desired: Real, leader: Option<(Real, Real)>) -> Real {
    let (a, b) = (idm.acceleration_mps2, idm.deceleration_mps2);
    let ratio = speed / desired.max(0.1);
    // above the desired speed a driver slows down comfortably, not as hard as the power law asks
    let mut acc = (a * (1.0 - math::pow(ratio, idm.exponent))).max(-b);
    if let Some((gap, leader_speed)) = leader {
        let closing = speed * (speed - leader_speed) / (2.0 * (a * b).sqrt());
        let wanted = idm.min_gap_m + (speed * idm.headway_s + closing).max(0.0);
        let pressure = wanted / gap.max(0.1);
        acc -= a * pressure * pressure;
    }
    acc.clamp(-idm.max_braking_mps2, a)
}

impl Idm {
    fn leader(world: &WorldView<'_>, agent_idx: usize, route: &Route, s: Real) -> Option<Leader> {
        let states = world.states;
        let own = &world.scene.bodies[agent_idx];
        let (x, y) = (states.x[agent_idx], states.y[agent_idx]);
        let (cos, sin) = (states.cos[agent_idx], states.sin[agent_idx]);
        let speed = states.speed_mps[agent_idx];
        let reach = (20.0 + speed * 4.0).min(70.0).min(route.path.length_m() - s);
        let window = window(route, s, reach);
        let (low, high) = bounds(window);
        let mut best: Option<Leader> = None;
        for j in 0..states.len() {
            if j == agent_idx || !states.active[j] {
                continue;
            }
            let body = &world.scene.bodies[j];
            let (dx, dy) = (states.x[j] - x, states.y[j] - y);
            // where the agent can matter: round the window, as far as it comes while it is anticipated
            let travel = states.speed_mps[j].abs() * world.config.idm.anticipation_s;
            let margin = own.half_width_m + body.radius_m + CLEARANCE_M + travel;
            if states.x[j] < low.x - margin
                || states.x[j] > high.x + margin
                || states.y[j] < low.y - margin
                || states.y[j] > high.y + margin
                || dx * cos + dy * sin < -(own.radius_m + body.radius_m)
            {
                continue;
            }
            let crossing = (states.cos[j] * cos + states.sin[j] * sin).abs() < 0.8;
            let moving = states.speed_mps[j].abs() > 0.5;
            let times = [0.0, world.config.idm.anticipation_s];
            for time_s in &times[..if crossing && moving { 2 } else { 1 }] {
                let px = states.x[j] + states.velocity_x_mps[j] * time_s;
                let py = states.y[j] + states.velocity_y_mps[j] * time_s;
                let Some((at_s, lateral, (tc, ts))) = nearest_ahead(route, s, window, px, py) else {
                    continue;
                };
                let along = (states.cos[j] * tc + states.sin[j] * ts).abs();
                let across = (states.sin[j] * tc - states.cos[j] * ts).abs();
                let half_side = across * body.half_length_m + along * body.half_width_m;
                let clearance = if moving { CLEARANCE_M } else { STANDING_CLEARANCE_M };
                if lateral.abs() > own.half_width_m + half_side + clearance {
                    continue;
                }
                let half_ahead = along * body.half_length_m + across * body.half_width_m;
                let gap_m = at_s - s - own.half_length_m - half_ahead;
                if best.is_none_or(|l| gap_m < l.gap_m) {
                    let v = states.velocity_x_mps[j] * tc + states.velocity_y_mps[j] * ts;
                    best = Some(Leader { gap_m, speed_mps: v.max(0.0) });
                }
            }
        }
        best
    }
}

/// Samples of a route, about a metre apart, from `s` on for `reach` metres; at least one.
fn window(route: &Route, s: Real, reach: Real) -> &[Point2] {
    let points = route.path.points();
    let first = (s as usize).min(points.len() - 1);
    let last = ((s + reach).ceil() as usize).clamp(first, points.len() - 1);
    &points[first..=last]
}

/// Least and greatest coordinates of a window; between its samples the route bends by less than a body's size.
fn bounds(window: &[Point2]) -> (Point2, Point2) {
    let last = window[window.len() - 1];
    window.iter().step_by(COARSE).fold((last, last), |(low, high), p| (low.inf(p), high.sup(p)))
}

/// Nearest position of the route ahead of `s` to a point: (position along the route, signed distance, tangent);
/// `None` when the point lies abreast or behind.
fn nearest_ahead(
    route: &Route,
    s: Real,
    window: &[Point2],
    x: Real,
    y: Real,
) -> Option<(Real, Real, (Real, Real))> {
    let mut best = (Real::MAX, 0);
    for k in (0..window.len()).step_by(COARSE) {
        let (dx, dy) = (x - window[k].x, y - window[k].y);
        let d2 = dx * dx + dy * dy;
        if d2 < best.0 {
            best = (d2, k);
        }
    }
    // two steps of projection on the local tangent
    let mut at_s = s.floor() + best.1 as Real;
    let mut at = route.path.at(at_s);
    for _ in 0..2 {
        let ahead = (x - at.position.x) * at.cos + (y - at.position.y) * at.sin;
        at_s = (at_s + ahead.clamp(-(COARSE as Real), COARSE as Real)).max(s);
        at = route.path.at(at_s);
    }
    let lateral = (y - at.position.y) * at.cos - (x - at.position.x) * at.sin;
    (at_s > s + 0.1).then_some((at_s, lateral, (at.cos, at.sin)))
}

impl BackgroundPolicy for Idm {
    fn name(&self) -> &'static str {
        "idm"
    }

    fn act(&self, world: &WorldView<'_>, agent_idx: usize) -> Motion {
        let route = &world.scene.routes[agent_idx];
        let pose = world.states.pose(agent_idx);
        if route.is_parked() {
            return Motion::Place(pose, Vector2::zeros());
        }
        let (config, dt) = (world.config, world.config.dt_s);
        let speed = world.states.speed_mps[agent_idx].max(0.0);
        let s = world.route_s_m[agent_idx];
        let desired = route
            .logged_speed_mps
            .max(MIN_DESIRED_MPS)
            .min(config.speed_limit_mps)
            .min(route.curve_speed_mps(s + speed * 0.5));
        let leader = Self::leader(world, agent_idx, route, s).map(|l| (l.gap_m, l.speed_mps));
        let next_speed = (speed + acceleration(&config.idm, speed, desired, leader) * dt).max(0.0);
        let next_s = s + 0.5 * (speed + next_speed) * dt;
        if next_s >= route.path.length_m() - 0.5 {
            return Motion::Leave;
        }
        if next_s - s < 1e-4 {
            return Motion::Place(pose, Vector2::zeros());
        }
        let at = route.path.at(next_s);
        let (dx, dy) = (at.position.x - pose.position.x, at.position.y - pose.position.y);
        let moved = math::hypot(dx, dy);
        // the heading turns towards the route's within a few metres: logs and lanes may disagree at the start
        let error = math::wrap_angle(math::atan2(at.sin, at.cos) - pose.heading_rad);
        let turn = error * (moved / 2.0).min(1.0);
        let next = Pose2::new(at.position.x, at.position.y, pose.heading_rad + turn);
        Motion::Place(next, Vector2::new(next.cos * next_speed, next.sin * next_speed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn free_road_keeps_the_desired_speed() {
        let idm = IdmConfig::default();
        assert!(acceleration(&idm, 10.0, 10.0, None).abs() < 1e-5);
        assert!((acceleration(&idm, 0.0, 10.0, None) - idm.acceleration_mps2).abs() < 1e-6);
    }

    #[test]
    fn equilibrium_gap_of_the_published_formula() {
        // at equal speeds the acceleration vanishes at gap (s0 + v T) / sqrt(1 - (v/v0)^delta)
        let idm = IdmConfig::default();
        let (v, v0) = (8.0f32, 12.0f32);
        let gap = (idm.min_gap_m + v * idm.headway_s) / (1.0 - (v / v0).powf(idm.exponent)).sqrt();
        assert!(acceleration(&idm, v, v0, Some((gap, v))).abs() < 1e-4);
    }

    #[test]
    fn a_wall_ahead_brakes_hard() {
        let idm = IdmConfig::default();
        assert_eq!(acceleration(&idm, 15.0, 15.0, Some((5.0, 0.0))), -idm.max_braking_mps2);
    }
}
