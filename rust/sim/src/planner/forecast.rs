//! Where the others will be: at constant velocity, with their headings.

use super::Scene;
use crate::geom::{OrientedBox, Point2, Real, Vector2};
use crate::state::Footprint;

/// Seconds of the proposals.
pub(super) const HORIZON_S: Real = 4.0;
/// Seconds ahead at which the time to contact is looked at.
pub(super) const AHEAD_S: [Real; 3] = [0.3, 0.6, 0.9];

/// Another agent and its forecast.
#[derive(Debug, Clone)]
pub(super) struct Other {
    pub position: Point2,
    pub velocity: Vector2,
    pub speed_mps: Real,
    cos: Real,
    sin: Real,
    pub footprint: Footprint,
    /// Place beside the centre line at each step.
    pub beside: Vec<Beside>,
}

/// A box beside the centre line.
#[derive(Debug, Clone, Copy)]
pub(super) struct Beside {
    pub s_m: Real,
    pub lateral_m: Real,
    /// Half of what it takes along the line, and across it, metres.
    pub half_along_m: Real,
    pub half_across_m: Real,
    /// Speed along the line, not below 0.
    pub speed_mps: Real,
}

impl Other {
    #[inline]
    pub(super) fn centre(&self, time_s: Real) -> Point2 {
        self.position + self.velocity * time_s
    }

    #[inline]
    pub(super) fn at(&self, time_s: Real) -> OrientedBox {
        OrientedBox {
            centre: self.centre(time_s),
            cos: self.cos,
            sin: self.sin,
            half_length_m: self.footprint.half_length_m,
            half_width_m: self.footprint.half_width_m,
        }
    }

    fn beside(&self, scene: &Scene<'_>, time_s: Real, hint_s_m: Option<Real>) -> Beside {
        let found = scene.line.project(self.centre(time_s), hint_s_m);
        let direction = scene.line.polyline().tangent_at(found.s_m);
        let along = (self.cos * direction.x + self.sin * direction.y).abs();
        let across = (self.sin * direction.x - self.cos * direction.y).abs();
        // past the line's corners the distance counts, as the offset from the segment says little there
        let lateral_m = found.distance_m.max(found.lateral_m.abs()).copysign(found.lateral_m);
        let f = &self.footprint;
        Beside {
            s_m: found.s_m,
            lateral_m,
            half_along_m: along * f.half_length_m + across * f.half_width_m,
            half_across_m: across * f.half_length_m + along * f.half_width_m,
            speed_mps: self.velocity.dot(&direction).max(0.0),
        }
    }
}

/// The others who can matter.
#[derive(Debug)]
pub(super) struct Forecast {
    pub others: Vec<Other>,
    pub num_steps: usize,
}

impl Forecast {
    pub(super) fn new(scene: &Scene<'_>) -> Self {
        let (states, ego) = (scene.states, scene.ego);
        let num_steps = (HORIZON_S / scene.dt_s).round().clamp(1.0, 400.0) as usize;
        let own_m = states.speed_mps[ego].max(0.0) * (HORIZON_S + 1.0) + 25.0;
        let mut others = Vec::new();
        for j in (0..states.len()).filter(|j| *j != ego && states.active[*j]) {
            let (position, velocity) = (states.position(j), states.velocity(j));
            let speed_mps = velocity.norm();
            if (position - states.position(ego)).norm() >= own_m + speed_mps * (HORIZON_S + 1.0) {
                continue;
            }
            let (cos, sin, footprint) = (states.cos[j], states.sin[j], *scene.footprint(j));
            let beside = Vec::new();
            let mut other = Other { position, velocity, speed_mps, cos, sin, footprint, beside };
            let moves = speed_mps > 0.05;
            for t in 0..num_steps {
                let next = match other.beside.last() {
                    Some(last) if !moves => *last,
                    last => other.beside(scene, t as Real * scene.dt_s, last.map(|b| b.s_m)),
                };
                other.beside.push(next);
            }
            others.push(other);
        }
        Self { others, num_steps }
    }
}
