//! Whether guided plans leave the ego a way out: by steady accelerations on and beside its route.

use super::planned_agents::is_ego;
use ccdiff_sim::drivers::WorldView;
use ccdiff_sim::geom::{Polyline, Pose2, Real, Vector2};
use ccdiff_sim::state::Footprint;

/// Accelerations that are tried, each held until the ego stands, m/s²: those of `ccdiff_env.record.counterfactual.ego_plans`.
const ACCELERATIONS_MPS2: [Real; 7] = [0.0, -1.5, -3.0, -5.0, -8.0, 1.5, 3.0];
/// Distances from the route that are tried, left positive, metres.
const OFFSETS_M: [Real; 5] = [0.0, 1.0, -1.0, 2.5, -2.5];
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
    let egos = (0..states.len()).filter(|a| states.active[*a] && is_ego(world, *a));
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
    egos.into_iter().all(has_way_out)
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

#[cfg(test)]
mod tests {
    use super::*;

    const DT_S: Real = 0.1;

    /// An ego at 10 m/s on a straight route along x, and whether it has a way out between vehicles that keep their velocities.
    fn has_way_out(others: &[([Real; 2], Real)]) -> bool {
        let route = Polyline::straight(&Pose2::new(0.0, 0.0, 0.0), 200.0);
        let footprint = Footprint::new(4.0, 2.0);
        let start = Start { route: &route, s_m: 20.0, offset_m: 0.0, speed_mps: 10.0, footprint };
        let plan = |([x, y], speed): &([Real; 2], Real)| -> Vec<Real> {
            (1..=50).flat_map(|t| [20.0 + x + speed * DT_S * t as Real, *y, 0.0]).collect()
        };
        let plans: Vec<Vec<Real>> = others.iter().map(plan).collect();
        let others: Vec<_> = plans.iter().map(|p| (footprint, p.as_slice())).collect();
        start.has_way_out(&others, DT_S)
    }

    #[test]
    fn a_vehicle_that_stands_beyond_the_braking_distance_leaves_a_way_out() {
        // 10 m/s: 6.3 m at 8 m/s², and 4 m of footprints
        assert!(has_way_out(&[]));
        assert!(has_way_out(&[([10.6, 0.0], 0.0), ([10.6, 2.5], 0.0), ([10.6, -2.5], 0.0)]));
        assert!(!has_way_out(&[([10.0, 0.0], 0.0), ([10.0, 2.5], 0.0), ([10.0, -2.5], 0.0)]));
    }

    #[test]
    fn one_that_comes_from_behind_is_outrun_or_let_past_unless_the_way_ahead_and_the_sides_are_closed() {
        assert!(has_way_out(&[([-12.0, 0.0], 14.0)]));
        let ahead = [([25.0, 0.0], 0.0), ([25.0, 3.0], 0.0), ([25.0, -3.0], 0.0)];
        assert!(has_way_out(&ahead));
        let behind = [([-12.0, 0.0], 14.0), ([-12.0, 3.0], 14.0), ([-12.0, -3.0], 14.0)];
        assert!(!has_way_out(&[ahead, behind].concat()));
    }

    #[test]
    fn nobody_escapes_from_a_vehicle_that_stands_on_the_ego() {
        assert!(!has_way_out(&[([0.0, 0.0], 10.0)]));
    }
}
