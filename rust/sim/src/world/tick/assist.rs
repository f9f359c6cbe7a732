//! From the action of assisted driving to that of the unicycle: IDM or PDM-Closed, and their ways come in here.

use crate::drivers::{WorldView, braking, idm_acceleration};
use crate::dynamics::{Action, AssistedBase, AssistedLimits, yaw_rate};
use crate::events::limits::ACCELERATION_MPS2;
use crate::geom::{Real, math};
use crate::pdm::{Scene, plan};

/// The route's curvature is that over this way before and behind, metres.
const CURVATURE_REACH_M: Real = 2.0;

/// Acceleration and yaw rate for a change of acceleration and an offset; vehicles that never move in the log stay parked,
/// and those whose log backs up wait.
pub fn assisted_action(
    limits: &AssistedLimits,
    view: &WorldView<'_>,
    agent_idx: usize,
    command: Action,
) -> Action {
    let states = view.states;
    let route = &view.scene.routes[agent_idx];
    if route.is_parked() {
        return [-states.speed_mps[agent_idx] / view.dt_s, 0.0, 0.0];
    }
    if view.backs_up(agent_idx) {
        return [braking(view.idm, states.speed_mps[agent_idx], view.dt_s), 0.0, 0.0];
    }
    let (base, yaw_rate) = match limits.base {
        AssistedBase::Idm => (idm_acceleration(view, agent_idx), beside_route(view, agent_idx, command[1])),
        AssistedBase::Pdm => {
            let scene =
                Scene::new(view.scene, states, agent_idx, view.dt_s, view.speed_limit_mps, view.step_idx);
            let plan = plan(&scene);
            (plan.acceleration_mps2, scene.yaw_rate(plan.offset_m + command[1]))
        }
    };
    let before = states.acceleration_mps2[agent_idx];
    let base = held(limits, base, before, view.dt_s);
    [limits.acceleration(base, command[0], before, view.dt_s), yaw_rate, 0.0]
}

/// The base's acceleration as far as its jerk allows; the emergency brake is not held.
fn held(limits: &AssistedLimits, base_mps2: Real, before_mps2: Real, dt_s: Real) -> Real {
    let least_mps2 = ACCELERATION_MPS2[0];
    let (from_mps2, change) = (before_mps2.max(least_mps2), limits.base_jerk_mps3 * dt_s);
    if base_mps2 <= least_mps2 { base_mps2 } else { base_mps2.clamp(from_mps2 - change, from_mps2 + change) }
}

/// Yaw rate that leads to a distance from the route.
fn beside_route(view: &WorldView<'_>, agent_idx: usize, offset_m: Real) -> Real {
    let (pose, speed) = (view.states.pose(agent_idx), view.states.speed_mps[agent_idx]);
    let (path, s_m) = (&view.scene.routes[agent_idx].path, view.route_s_m[agent_idx]);
    let at = path.at(s_m);
    let d = pose.position - at.position;
    let (behind, ahead) = (path.at(s_m - CURVATURE_REACH_M), path.at(s_m + CURVATURE_REACH_M));
    let turn = math::atan2(
        behind.cos * ahead.sin - behind.sin * ahead.cos,
        behind.cos * ahead.cos + behind.sin * ahead.sin,
    );
    let (distance_m, error_sin) = (d.y * at.cos - d.x * at.sin, pose.sin * at.cos - pose.cos * at.sin);
    yaw_rate(distance_m - offset_m, error_sin, turn / (2.0 * CURVATURE_REACH_M), speed)
}
