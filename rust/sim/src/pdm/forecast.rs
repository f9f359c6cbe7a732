//! Where the others will be: at constant speed along their headings.

use super::Scene;
use crate::events::limits::STOPPED_MPS;
use crate::geom::{OrientedBox, Point2, Pose2, Real, Vector2};
use crate::scene::AgentKind;
use crate::state::Footprint;

/// Seconds of the proposals.
pub(super) const HORIZON_S: Real = 4.0;
/// Seconds ahead at which the time to contact is looked at.
pub(super) const AHEAD_S: [Real; 4] = [0.0, 0.3, 0.6, 0.9];

/// Greatest distance of a proposal from the centre line, metres.
pub(super) const MOST_OFFSET_M: Real = 1.0;
/// Distances are certain to this, metres.
const MARGIN_M: Real = 0.1;

/// Another agent and its forecast.
#[derive(Debug, Clone)]
pub(super) struct Other {
    pub pose: Pose2,
    /// Along its heading, forwards or backwards: that of boxes is noisier than their headings are.
    velocity: Vector2,
    pub speed_mps: Real,
    pub is_static: bool,
    pub footprint: Footprint,
}

/// A box beside the centre line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Beside {
    pub s_m: Real,
    pub lateral_m: Real,
    /// Half of what it takes along the line, and across it, metres.
    pub half_along_m: Real,
    pub half_across_m: Real,
    /// Speed along the line, below 0 if it comes the other way.
    pub speed_mps: Real,
}

impl Other {
    #[inline]
    pub(super) fn centre(&self, time_s: Real) -> Point2 {
        self.pose.position + self.velocity * time_s
    }

    #[inline]
    pub(super) fn at(&self, time_s: Real) -> OrientedBox {
        self.footprint.at(&Pose2 { position: self.centre(time_s), ..self.pose })
    }

    fn beside(&self, scene: &Scene<'_>, step: usize, hint_s_m: Option<Real>) -> Beside {
        let found = scene.line.project(self.centre(step as Real * scene.dt_s), hint_s_m);
        let direction = scene.line.polyline().tangent_at(found.s_m);
        let Pose2 { cos, sin, .. } = self.pose;
        let along = (cos * direction.x + sin * direction.y).abs();
        let across = (sin * direction.x - cos * direction.y).abs();
        // past the line's corners the distance counts, as the offset from the segment says little there
        let lateral_m = found.distance_m.max(found.lateral_m.abs()).copysign(found.lateral_m);
        let f = &self.footprint;
        Beside {
            s_m: found.s_m,
            lateral_m,
            half_along_m: along * f.half_length_m + across * f.half_width_m,
            half_across_m: across * f.half_length_m + along * f.half_width_m,
            speed_mps: self.velocity.dot(&direction),
        }
    }
}

/// The other agents that matter; those that already touch the ego do not.
#[derive(Debug)]
pub(super) struct Forecast {
    pub others: Vec<Other>,
    pub num_steps: usize,
    /// Boxes of agents ever near enough to the centre line to be a leader, step after step.
    beside: Vec<Beside>,
}

impl Forecast {
    pub(super) fn new(scene: &Scene<'_>) -> Self {
        let (states, ego) = (scene.states, scene.ego);
        let num_steps = (HORIZON_S / scene.dt_s).round().clamp(1.0, 400.0) as usize;
        let own_m = states.speed_mps[ego].max(0.0) * (HORIZON_S + 1.0) + 25.0;
        let (mut others, mut near) = (Vec::new(), Vec::new());
        let body = scene.footprint(ego).at(&states.pose(ego));
        let half_way_m = scene.footprint(ego).half_width_m + MOST_OFFSET_M + MARGIN_M;
        let matters = |j: &usize| *j != ego && states.active[*j] && states.same_level(ego, *j);
        for j in (0..states.len()).filter(matters) {
            let is_static = scene.prepared.kinds[j] == AgentKind::Static;
            let (pose, footprint) = (states.pose(j), *scene.footprint(j));
            let speed_mps = if is_static { 0.0 } else { states.velocity(j).norm() };
            let far_m = own_m + speed_mps * (HORIZON_S + 1.0);
            if (pose.position - states.position(ego)).norm() >= far_m || body.overlaps(&footprint.at(&pose)) {
                continue;
            }
            let heading = Vector2::new(pose.cos, pose.sin);
            let velocity = heading * speed_mps.copysign(states.velocity(j).dot(&heading));
            let moves = speed_mps > STOPPED_MPS;
            let other = Other { pose, velocity, speed_mps, is_static, footprint };
            let first = other.beside(scene, 0, None);
            let comes_m = speed_mps * scene.dt_s * num_steps as Real;
            if first.lateral_m.abs() < footprint.radius_m + half_way_m + comes_m {
                let begin = near.len();
                near.push(first);
                for t in 1..num_steps {
                    let last = near[near.len() - 1];
                    near.push(if moves { other.beside(scene, t, Some(last.s_m)) } else { last });
                }
                let leads = |b: &Beside| b.lateral_m.abs() < b.half_across_m + half_way_m;
                if !near[begin..].iter().any(leads) {
                    near.truncate(begin);
                }
            }
            others.push(other);
        }
        let beside = (0..num_steps).flat_map(|t| near.iter().skip(t).step_by(num_steps)).copied().collect();
        Self { others, num_steps, beside }
    }

    /// Boxes beside the centre line at a step.
    pub(super) fn beside(&self, step: usize) -> &[Beside] {
        let count = self.beside.len() / self.num_steps;
        &self.beside[step * count..(step + 1) * count]
    }
}
