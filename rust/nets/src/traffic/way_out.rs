//! Whether guided plans leave the ego a way out: by steady accelerations on and beside its route.

use super::planned_agents::egos_of;
use ccdiff_sim::drivers::WorldView;
use ccdiff_sim::geom::{Polyline, Pose2, Real, Vector2};
use ccdiff_sim::state::Footprint;

/// Accelerations that are tried, each held until the ego stands, m/s².
pub const ACCELERATIONS_MPS2: [Real; 7] = [0.0, -1.5, -3.0, -5.0, -8.0, 1.5, 3.0];
/// Distances from the route that are tried, left positive, metres.
pub const OFFSETS_M: [Real; 5] = [0.0, 1.0, -1.0, 2.5, -2.5];
/// Speed with which the ego moves over, m/s, and most of it for each metre ahead.
const LATERAL_MPS: Real = 1.0;
const LATERAL_SHARE: Real = 0.3;

/// An ego as it stands on its route.
struct Start<'a> {
    route: &'a Polyline,
    /// Arc length, metres.
    s_m: Real,
    /// Distance from the route, left positive, metres.
    offset_m: Real,
    speed_mps: Real,
    footprint: Footprint,
}

/// Poses (x, y, heading) of a vehicle after each step of its plan, [T, 3].
pub(super) struct PlannedPoses<'a> {
    pub(super) agent_idx: usize,
    pub(super) poses: &'a [Real],
}

/// Whether every ego that is there can drive on without touching one of the planned vehicles while their plans last.
/// All others are left out of account.
pub(super) fn exists(world: &WorldView<'_>, plans: &[PlannedPoses<'_>]) -> bool {
    let (states, scene) = (world.states, world.scene);
    let has_way_out = |ego: usize| {
        let others = plans.iter().filter(|p| states.same_level(ego, p.agent_idx));
        let others: Vec<(Footprint, &[Real])> =
            others.map(|p| (scene.footprints[p.agent_idx], p.poses)).collect();
        let route = &scene.routes[ego].path;
        let at = route.project_near(states.position(ego), world.route_s_m[ego], 10.0);
        let start = Start {
            route,
            s_m: at.s_m,
            offset_m: at.lateral_m,
            speed_mps: states.speed_mps[ego].max(0.0),
            footprint: scene.footprints[ego],
        };
        start.has_way_out(&others, world.dt_s)
    };
    egos_of(world).into_iter().all(has_way_out)
}

impl Start<'_> {
    fn has_way_out(&self, others: &[(Footprint, &[Real])], dt_s: Real) -> bool {
        let ways = OFFSETS_M.iter().flat_map(|offset| ACCELERATIONS_MPS2.iter().map(move |a| (*a, *offset)));
        ways.into_iter().any(|(acceleration, offset)| {
            others
                .iter()
                .all(|(footprint, poses)| !self.touches(acceleration, offset, footprint, poses, dt_s))
        })
    }

    /// Whether the ego touches a planned vehicle on one of the ways.
    fn touches(
        &self,
        acceleration: Real,
        offset_m: Real,
        footprint: &Footprint,
        poses: &[Real],
        dt_s: Real,
    ) -> bool {
        let reach_m = self.footprint.radius_m + footprint.radius_m;
        poses.chunks_exact(3).enumerate().any(|(step, pose)| {
            let pose = Pose2::new(pose[0], pose[1], pose[2]);
            let ego = self.pose(acceleration, offset_m, (step + 1) as Real * dt_s);
            (pose.position - ego.position).norm() <= reach_m
                && self.footprint.at(&ego).overlaps(&footprint.at(&pose))
        })
    }

    /// Where the ego is after a time, with the heading of the route.
    fn pose(&self, acceleration: Real, offset_m: Real, time_s: Real) -> Pose2 {
        let moving_s = if acceleration < 0.0 { time_s.min(-self.speed_mps / acceleration) } else { time_s };
        let ahead_m = self.speed_mps * moving_s + 0.5 * acceleration * moving_s * moving_s;
        let most_m = (LATERAL_MPS * time_s).min(LATERAL_SHARE * ahead_m);
        let offset_m = self.offset_m + (offset_m - self.offset_m).clamp(-most_m, most_m);
        let on_route = self.route.at(self.s_m + ahead_m);
        let left = Vector2::new(-on_route.sin, on_route.cos);
        Pose2 { position: on_route.position + left * offset_m, ..on_route }
    }
}
