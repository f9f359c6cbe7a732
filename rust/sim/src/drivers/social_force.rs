//! The social force model of pedestrians (Helbing, Molnár 1995, Phys. Rev. E 51) in its circular form, with the figures
//! that Johansson, Helbing, Shukla (2007, Adv. Complex Syst. 10) fitted to recorded walkers.
//!
//! dv/dt = (v₀·e − v) / τ + Σ w(φ)·A·exp((r − d) / B)·n,  w(φ) = λ + (1 − λ)·(1 + cos φ) / 2.
//!
//! e points along the logged path, v₀ is the speed that keeps up with the log. d is the distance to another pedestrian, n
//! points away from it, φ is the angle between the walk and the other one.
//!
//! The model was fitted to pedestrians alone. For moving vehicles, ours: d is the distance to the way of the box over the
//! next seconds, the repulsion stops a pedestrian that walks towards it, and w = max(0, −e·n) spares one beside it.

use super::{AgentMotion, DriverModel, Kind, PlanState, WorldView};
use crate::geom::{Pose2, Real, Vector2, math};
use crate::scene::AgentKind;

/// Relaxation time τ, seconds.
const RELAXATION_S: Real = 0.5;
/// Strength A of the repulsion between pedestrians, m/s².
const STRENGTH_MPS2: Real = 0.42;
/// Strength of that from vehicles that move, m/s².
const VEHICLE_STRENGTH_MPS2: Real = 10.0;
/// Reach B of both, metres.
const REACH_M: Real = 1.65;
/// Share λ of the repulsion that comes from behind.
const FROM_BEHIND: Real = 0.12;
/// Others farther than this do not repel, metres.
const FARTHEST_M: Real = 15.0;
/// How far ahead the way of a vehicle is seen, seconds.
const AHEAD_S: Real = 2.0;
/// A vehicle slower than this is walked round by the logged path, m/s.
const STATIONARY_MPS: Real = 0.5;
/// Time in which a pedestrian wants to be where its log is, seconds.
const CATCH_UP_S: Real = 1.0;
/// Greatest speed as a factor of the greatest logged one, and the least that it may be, m/s.
const HASTE: (Real, Real) = (1.3, 1.0);
/// Distance to the point of the path that is walked to, metres.
const LOOK_AHEAD_M: Real = 1.0;
/// Distance from the end of the logged path at which it is reached, metres.
const THERE_M: Real = 0.3;

pub(super) const KIND: Kind = Kind {
    name: "social_force",
    title: "social force",
    style: "other",
    options: None,
    always: false,
    make: Some(|_, _| Ok(Box::new(SocialForce))),
};

/// Walks along the logged path and gives way.
#[derive(Debug, Default)]
pub struct SocialForce;

/// Repulsion of another pedestrian at a distance, in the direction `away` (unit), on a walk in the direction `walk`.
fn repulsion(gap_m: Real, away: Vector2, walk: Vector2) -> Vector2 {
    let seen = FROM_BEHIND + (1.0 - FROM_BEHIND) * (1.0 - walk.dot(&away)) / 2.0;
    away * (seen * STRENGTH_MPS2 * math::exp(-gap_m / REACH_M))
}

/// Repulsion of a vehicle whose way is at a distance, on a path in the direction `path`.
fn vehicle_repulsion(gap_m: Real, away: Vector2, path: Vector2) -> Vector2 {
    away * ((-path.dot(&away)).max(0.0) * VEHICLE_STRENGTH_MPS2 * math::exp(-gap_m / REACH_M))
}

/// Gap from a point to the way of a box over the next seconds, metres, and the direction away from it.
fn vehicle_gap(from: Vector2, pose: &Pose2, velocity: Vector2, half: (Real, Real)) -> (Real, Vector2) {
    let ahead_m = (velocity.x * pose.cos + velocity.y * pose.sin).max(0.0) * AHEAD_S;
    let local = pose.to_local(from.into());
    // the box grown by its way ahead
    let nearest_x = local.x.clamp(-half.0, half.0 + ahead_m);
    let nearest_y = local.y.clamp(-half.1, half.1);
    let (dx, dy) = (local.x - nearest_x, local.y - nearest_y);
    let gap = math::hypot(dx, dy);
    // inside: to the side
    let side = if local.y < 0.0 { -1.0 } else { 1.0 };
    let away = if gap > 1e-3 { Vector2::new(dx / gap, dy / gap) } else { Vector2::new(0.0, side) };
    (gap, pose.rotate(away))
}

/// Where the log is on the path after a time, and where it ends: metres along the path.
fn logged(world: &WorldView<'_>, agent_idx: usize) -> (Real, Real, usize) {
    let scene = &world.scene.scene;
    let valid = |t: &usize| scene.is_valid(agent_idx, *t);
    let last = (0..scene.num_steps).rev().find(valid).unwrap_or(0);
    let wanted = world.step_idx + (CATCH_UP_S / world.dt_s) as usize;
    let at = (0..=wanted.min(last)).rev().find(valid).unwrap_or(last);
    (world.scene.logged_s_m(agent_idx, at), world.scene.logged_s_m(agent_idx, last), last)
}

impl DriverModel for SocialForce {
    fn name(&self) -> &str {
        KIND.name
    }

    fn act(&self, world: &WorldView<'_>, _: Option<&PlanState>, agent_idx: usize) -> AgentMotion {
        let (states, scene) = (world.states, world.scene);
        let (route, pose, s) = (&scene.routes[agent_idx], states.pose(agent_idx), world.route_s_m[agent_idx]);
        let (wanted_s, end_s, last_step) = logged(world, agent_idx);
        if end_s - s < THERE_M && world.step_idx >= last_step {
            return AgentMotion::Leave;
        }
        let (here, velocity) = (pose.position.coords, states.velocity(agent_idx));
        let to = route.path.at((s + LOOK_AHEAD_M).min(end_s.max(s))).position.coords - here;
        let direction = to.try_normalize(1e-3).unwrap_or_else(Vector2::zeros);
        let greatest = (HASTE.0 * route.logged_speed_mps).max(HASTE.1);
        let desired = ((wanted_s - s) / CATCH_UP_S).clamp(0.0, greatest);
        let mut force = (direction * desired - velocity) / RELAXATION_S;
        let walk = velocity.try_normalize(0.1).unwrap_or(direction);
        let radius = |a: usize| scene.footprints[a].half_length_m.max(scene.footprints[a].half_width_m);
        for other in (0..states.len()).filter(|a| *a != agent_idx && states.active[*a]) {
            let offset = here - states.position(other).coords;
            if offset.norm_squared() > FARTHEST_M * FARTHEST_M || !states.same_level(agent_idx, other) {
                continue;
            }
            match scene.kinds[other] {
                AgentKind::Pedestrian => {
                    let away = offset.try_normalize(1e-3).unwrap_or_else(|| Vector2::new(0.0, 1.0));
                    let gap = offset.norm() - radius(agent_idx) - radius(other);
                    force += repulsion(gap, away, walk);
                }
                AgentKind::Static => {}
                _ if states.speed_mps[other].abs() < STATIONARY_MPS => {}
                _ => {
                    let footprint = &scene.footprints[other];
                    let half = (footprint.half_length_m, footprint.half_width_m);
                    let (gap, away) = vehicle_gap(here, &states.pose(other), states.velocity(other), half);
                    force += vehicle_repulsion(gap - radius(agent_idx), away, direction);
                }
            }
        }
        let mut next = velocity + force * world.dt_s;
        let speed = next.norm();
        if speed > greatest {
            next *= greatest / speed;
        }
        let position = pose.position + next * world.dt_s;
        // standing or slow pedestrians keep the heading
        let heading = if next.norm() > 0.3 { math::atan2(next.y, next.x) } else { pose.heading_rad };
        AgentMotion::Place(Pose2::new(position.x, position.y, heading), next)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_repulsion_is_that_of_the_formula() {
        // straight ahead, at one reach: A / e; from behind λ of it
        let (walk, away) = (Vector2::new(1.0, 0.0), Vector2::new(-1.0, 0.0));
        let ahead = repulsion(REACH_M, away, walk);
        assert!((ahead.x + STRENGTH_MPS2 / std::f32::consts::E).abs() < 1e-6 && ahead.y == 0.0);
        let behind = repulsion(REACH_M, walk, walk);
        assert!((behind.x - FROM_BEHIND * STRENGTH_MPS2 / std::f32::consts::E).abs() < 1e-6);
    }
}
