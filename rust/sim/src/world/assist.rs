//! From the action of assisted driving to that of the unicycle: IDM and the route come in here.

use crate::dynamics::{Action, AssistedLimits, BesideRoute};
use crate::geom::{Real, math};
use crate::policy::{WorldView, idm_acceleration};

/// The route's curvature is that over this way before and behind, metres.
const CURVATURE_REACH_M: Real = 2.0;

/// Acceleration and yaw rate of an agent for a change of IDM's acceleration and a distance from the route. Vehicles
/// that never move in the log stay parked.
pub(crate) fn unicycle_action(
    limits: &AssistedLimits,
    view: &WorldView<'_>,
    agent_idx: usize,
    command: Action,
) -> Action {
    let states = view.states;
    let (pose, speed, dt_s) = (states.pose(agent_idx), states.speed_mps[agent_idx], view.dt_s);
    let Some(idm) = idm_acceleration(view, agent_idx) else { return [-speed / dt_s, 0.0, 0.0] };
    let acceleration = limits.acceleration(idm, command[0], states.acceleration_mps2[agent_idx], dt_s);
    let (path, s_m) = (&view.scene.routes[agent_idx].path, view.route_s_m[agent_idx]);
    let at = path.at(s_m);
    let d = pose.position - at.position;
    let (behind, ahead) = (path.at(s_m - CURVATURE_REACH_M), path.at(s_m + CURVATURE_REACH_M));
    let turn = math::atan2(
        behind.cos * ahead.sin - behind.sin * ahead.cos,
        behind.cos * ahead.cos + behind.sin * ahead.sin,
    );
    let beside = BesideRoute {
        distance_m: d.y * at.cos - d.x * at.sin,
        sin: pose.sin * at.cos - pose.cos * at.sin,
        curvature_1pm: turn / (2.0 * CURVATURE_REACH_M),
    };
    [acceleration, limits.yaw_rate(&beside, command[1], speed), 0.0]
}
