//! The intelligent driver model along a route (Treiber, Hennecke, Helbing 2000, Phys. Rev. E 62).
//!
//! a = a_max · (1 − (v / v₀)^δ − (s* / gap)²),  s* = s₀ + max(0, v·T + v·Δv / (2·√(a_max·b))).
//!
//! The leader is the nearest agent on the route ahead, see [`leader`]. v₀ is the agent's own greatest logged speed, at most
//! the speed limit and what the curves ahead allow. Vehicles that never move in the log stay parked. While the log of one
//! backs up, it goes with its log where it is at its logged place, else it waits.

use super::{AgentMotion, DriverModel, Kind, PlanState, Replay, WorldView};
use crate::events::{ANTICIPATION_S, leader};
use crate::geom::{Pose2, Real, Vector2, math};
use crate::options;
use crate::options::{POSITIVE_MOTION, within};

pub(super) const KIND: Kind = Kind {
    name: "idm",
    title: "IDM",
    style: "idm",
    options: Some(&IdmConfig::TABLE),
    always: true,
    make: Some(|path, text| Ok(Box::new(Idm { config: options::read(path, text)? }))),
};

options! {
    /// Parameters of the intelligent driver model (Treiber, Hennecke, Helbing 2000).
    #[derive(Clone, Copy)]
    #[serde(deny_unknown_fields, default)]
    pub struct IdmConfig {
        /// Time headway T.
        headway_s: Real = 1.2, unit "s", range within(0.0, 60.0).open_below();
        /// Gap at standstill s₀.
        min_gap_m: Real = 2.0, unit "m", range within(0.0, 100.0);
        /// Greatest acceleration a.
        acceleration_mps2: Real = 1.5, unit "m/s²", range POSITIVE_MOTION;
        /// Comfortable deceleration b.
        deceleration_mps2: Real = 2.5, unit "m/s²", range POSITIVE_MOTION;
        /// Hardest braking.
        max_braking_mps2: Real = 8.0, unit "m/s²", range POSITIVE_MOTION;
        /// Acceleration exponent δ.
        exponent: Real = 4.0, range within(0.0, 100.0).open_below();
        /// Other agents also count at their positions after this time at constant velocity.
        anticipation_s: Real = ANTICIPATION_S, unit "s", range within(0.0, 60.0);
    }
}

/// Desired speed of a vehicle whose log is slower than this, m/s.
const MIN_DESIRED_MPS: Real = 4.0;

/// Routes are this near to the places that they are made from, metres: a vehicle that is put on its route moves no farther
/// beside its way in a step.
const BESIDE_M: Real = 0.25;
/// Tightest turn, rad/m.
const TIGHTEST_RADPM: Real = 0.28;

/// Follows the agent's route and keeps its distance.
#[derive(Debug, Default)]
pub struct Idm {
    /// Its parameters.
    pub config: IdmConfig,
}

/// Acceleration of the model towards a desired speed, behind a leader (gap in metres, its speed), m/s², between
/// −`max_braking` and `acceleration`.
pub fn idm_towards(idm: &IdmConfig, speed: Real, desired: Real, leader: Option<(Real, Real)>) -> Real {
    idm_with(idm, speed, leader, math::pow(share_of(speed, desired), idm.exponent))
}

/// Share of a desired speed.
#[inline]
pub(crate) fn share_of(speed: Real, desired: Real) -> Real {
    speed / desired.max(0.1)
}

/// The same from the power of that share.
#[inline]
pub(crate) fn idm_with(idm: &IdmConfig, speed: Real, leader: Option<(Real, Real)>, power: Real) -> Real {
    let (a, b) = (idm.acceleration_mps2, idm.deceleration_mps2);
    // above the desired speed a driver slows down comfortably, not as hard as the power law asks
    let mut acc = (a * (1.0 - power)).max(-b);
    if let Some((gap, leader_speed)) = leader {
        let closing = speed * (speed - leader_speed) / (2.0 * (a * b).sqrt());
        let wanted = idm.min_gap_m + (speed * idm.headway_s + closing).max(0.0);
        let pressure = wanted / gap.max(0.1);
        acc -= a * pressure * pressure;
    }
    acc.clamp(-idm.max_braking_mps2, a)
}

impl Idm {
    /// Acceleration of an agent on its route, m/s².
    fn wanted_acceleration(&self, world: &WorldView<'_>, agent_idx: usize) -> Real {
        let (idm, route) = (&self.config, &world.scene.routes[agent_idx]);
        let speed = world.states.speed_mps[agent_idx].max(0.0);
        if world.backs_up(agent_idx) {
            return braking(idm, speed, world.dt_s);
        }
        let s = world.route_s_m[agent_idx];
        let desired = route
            .logged_speed_mps
            .max(MIN_DESIRED_MPS)
            .min(world.speed_limit_mps)
            .min(route.curve_speed_mps(s + speed * 0.5));
        let ahead =
            leader(world.states, &world.scene.footprints, &route.path, s, agent_idx, idm.anticipation_s);
        let wanted = idm_towards(idm, speed, desired, ahead.map(|l| (l.gap_m, l.speed_mps)));
        let waits = braking_at_light(world, agent_idx, desired, idm, idm.max_braking_mps2);
        waits.map_or(wanted, |braking| wanted.min(braking))
    }
}

/// Acceleration of the model towards the stop line at which an agent waits for a light: in red if braking up to `red_mps2`
/// stops it in time, in yellow if comfortable braking does; m/s².
pub fn braking_at_light(
    world: &WorldView<'_>,
    agent_idx: usize,
    desired: Real,
    idm: &IdmConfig,
    red_mps2: Real,
) -> Option<Real> {
    let scene = world.scene;
    let front_m = world.route_s_m[agent_idx] + scene.footprints[agent_idx].half_length_m;
    let speed = world.states.speed_mps[agent_idx].max(0.0);
    let (lights, braking) = (&scene.routes[agent_idx].lights, [red_mps2, idm.deceleration_mps2]);
    let at_m = scene.scene.map.waits_at(lights, front_m, speed, world.step_idx, braking)?;
    Some(idm_towards(idm, speed, desired, Some((at_m - front_m, 0.0))))
}

/// Acceleration that brings an agent to a stand, m/s².
pub(crate) fn braking(idm: &IdmConfig, speed: Real, dt_s: Real) -> Real {
    (-speed / dt_s).clamp(-idm.max_braking_mps2, idm.max_braking_mps2)
}

/// Acceleration with which the model, as the world has it, would drive an agent along its route, m/s².
pub fn idm_acceleration(world: &WorldView<'_>, agent_idx: usize) -> Real {
    Idm { config: *world.idm }.wanted_acceleration(world, agent_idx)
}

impl DriverModel for Idm {
    fn name(&self) -> &str {
        KIND.name
    }

    fn act(&self, world: &WorldView<'_>, _: Option<&PlanState>, agent_idx: usize) -> AgentMotion {
        let route = &world.scene.routes[agent_idx];
        let pose = world.states.pose(agent_idx);
        if route.is_parked() {
            return AgentMotion::Place(pose, Vector2::zeros());
        }
        let log = &world.scene.log;
        if world.backs_up(agent_idx)
            && log.has(agent_idx, world.step_idx + 1)
            && log.position(agent_idx, world.step_idx) == Some(pose.position)
        {
            return Replay.act(world, None, agent_idx);
        }
        let dt = world.dt_s;
        let speed = world.states.speed_mps[agent_idx].max(0.0);
        let s = world.route_s_m[agent_idx];
        let next_speed = (speed + self.wanted_acceleration(world, agent_idx) * dt).max(0.0);
        let next_s = s + 0.5 * (speed + next_speed) * dt;
        if next_s >= route.path.length_m() - 0.5 {
            return AgentMotion::Leave;
        }
        if next_s - s < 1e-4 {
            return AgentMotion::Place(pose, Vector2::zeros());
        }
        let at = route.path.at(next_s);
        let way = at.position - pose.position;
        let (full, most) = (math::hypot(way.x, way.y), next_s - s + BESIDE_M);
        let (moved, place) = match full > most {
            true => (most, pose.position + way * (most / full)),
            false => (full, at.position),
        };
        // the heading turns towards the route's within a few metres: logs and lanes may disagree at the start
        let error = math::wrap_angle(math::atan2(at.sin, at.cos) - pose.heading_rad);
        let turn = (error * (moved / 2.0).min(1.0)).clamp(-TIGHTEST_RADPM * moved, TIGHTEST_RADPM * moved);
        let next = Pose2::new(place.x, place.y, pose.heading_rad + turn);
        AgentMotion::Place(next, Vector2::new(next.cos * next_speed, next.sin * next_speed))
    }
}
