//! Proposals: a share of the speed limit and a distance from the centre line, rolled out with IDM and the unicycle.

use super::Scene;
use super::forecast::{Beside, Forecast, MOST_OFFSET_M};
use crate::dynamics::{Dynamics, KinState, UnicycleLimits};
use crate::geom::{Real, Vector2, math};
use crate::policy::{IdmConfig, idm_with, share_of};
use crate::stage::{CentreLine, Place};
use crate::state::Footprint;

/// Shares of the speed limit, and distances from the centre line, metres.
const SHARES: [Real; 5] = [0.2, 0.4, 0.6, 0.8, 1.0];
const OFFSETS_M: [Real; 3] = [0.0, -MOST_OFFSET_M, MOST_OFFSET_M];
/// IDM of PDM-Closed.
const IDM: IdmConfig = IdmConfig {
    headway_s: 1.5,
    min_gap_m: 1.0,
    acceleration_mps2: 1.5,
    deceleration_mps2: 3.0,
    max_braking_mps2: 3.0,
    exponent: 10.0,
    anticipation_s: 0.0,
};
/// The tracker accelerates towards the speed planned for this time ahead, s, by this share of what would reach it (an LQR
/// with weights 10 and 1), and the acceleration follows with a lag, s.
const LOOK_S: Real = 1.0;
const SHARE: Real = 10.0 / 11.0;
const LAG_S: Real = 0.2;
/// Greatest change of the yaw rate, rad/s².
const YAW_ACCELERATION_RADPS2: Real = 0.75;
/// Lateral acceleration up to which the tracker steers, m/s², and its highest yaw rate, rad/s.
const TURN_MPS2: Real = 4.5;
const YAW_RATE_RADPS: Real = 0.9;

/// One way to drive on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Proposal {
    pub share: Real,
    pub offset_m: Real,
}

/// What a proposal would do.
#[derive(Debug, Clone)]
pub(super) struct Rollout {
    /// States, one more than steps.
    pub states: Vec<KinState>,
    /// Cosine and sine of their headings.
    pub directions: Vec<Vector2>,
    /// Acceleration and yaw rate of each step.
    pub actions: Vec<[Real; 2]>,
    /// Way along the line, metres.
    pub progress_m: Real,
}

/// Yaw rate that follows a curve, critically damped in the distance from it.
pub(crate) fn steering(
    limits: &UnicycleLimits,
    speed_mps: Real,
    curvature_1pm: Real,
    heading_error_rad: Real,
    lateral_m: Real,
) -> Real {
    curve(limits, speed_mps, curvature_1pm, math::sin_cos(heading_error_rad).0, lateral_m)
}

#[inline]
fn curve(
    limits: &UnicycleLimits,
    speed_mps: Real,
    curvature_1pm: Real,
    error_sin: Real,
    lateral_m: Real,
) -> Real {
    let length_m = (0.7 * speed_mps).max(3.0);
    let wanted =
        curvature_1pm - 2.0 / length_m * error_sin - lateral_m.clamp(-1.5, 1.5) / (length_m * length_m);
    let most = TURN_MPS2 / speed_mps.max(1.0).powi(2);
    let bound = limits.yaw_rate_bound(speed_mps).min(YAW_RATE_RADPS);
    (speed_mps * wanted.clamp(-most, most)).clamp(-bound, bound)
}

/// Where a state is beside the line near an arc length.
pub(super) struct BesideLine {
    at: Place,
    /// Along the line from there, and left of it, metres.
    ahead_m: Real,
    lateral_m: Real,
    heading_error_rad: Real,
}

impl BesideLine {
    #[inline]
    pub(super) fn new(line: &CentreLine, s_m: Real, state: &KinState) -> Self {
        let at = line.at(s_m);
        let (sin, cos) = math::sin_cos(at.heading_rad);
        let (dx, dy) = (state.x - at.position.x, state.y - at.position.y);
        let (ahead_m, lateral_m) = (dx * cos + dy * sin, dy * cos - dx * sin);
        let heading_error_rad =
            math::wrap_angle(state.heading_rad - at.heading_rad - at.curvature_1pm * ahead_m);
        Self { at, ahead_m, lateral_m, heading_error_rad }
    }

    /// Yaw rate that leads to a distance from the line, after a yaw rate in the step before.
    pub(super) fn yaw_rate(&self, speed_mps: Real, offset_m: Real, before_radps: Real, dt_s: Real) -> Real {
        self.steered(speed_mps, offset_m, before_radps, dt_s, math::sin_cos(self.heading_error_rad).0)
    }

    /// The same with the sine of the heading error.
    #[inline]
    fn steered(
        &self,
        speed_mps: Real,
        offset_m: Real,
        before_radps: Real,
        dt_s: Real,
        error_sin: Real,
    ) -> Real {
        let (curvature_1pm, lateral_m) = (self.at.curvature_1pm, self.lateral_m - offset_m);
        let limits = UnicycleLimits::default();
        let wanted = curve(&limits, speed_mps, curvature_1pm, error_sin, lateral_m);
        let change = YAW_ACCELERATION_RADPS2 * dt_s;
        wanted.clamp(before_radps - change, before_radps + change)
    }
}

/// A proposal on its way.
struct Drive<'a> {
    proposal: &'a Proposal,
    /// Speeds that IDM plans, m/s: now, after each step, and some steps further.
    planned_mps: Vec<Real>,
    state: KinState,
    cos: Real,
    sin: Real,
    s_m: Real,
    /// Acceleration and yaw rate of the last step.
    last: [Real; 2],
    out: Rollout,
}

impl<'a> Drive<'a> {
    fn new(scene: &Scene<'_>, forecast: &Forecast, proposal: &'a Proposal, look: usize) -> Self {
        let (state, s_m, num_steps) = (scene.present(), scene.place.s_m, forecast.num_steps);
        let (sin, cos) = math::sin_cos(state.heading_rad);
        let acceleration = scene.states.acceleration_mps2[scene.ego].clamp(-8.0, 4.0);
        let last = [acceleration, scene.states.yaw_rate_radps[scene.ego]];
        let mut out = Rollout {
            states: Vec::with_capacity(num_steps + 1),
            directions: Vec::with_capacity(num_steps + 1),
            actions: Vec::with_capacity(num_steps),
            progress_m: 0.0,
        };
        out.states.push(state);
        out.directions.push(Vector2::new(cos, sin));
        let planned_mps = proposal.speeds(scene, forecast, look);
        Self { proposal, planned_mps, state, cos, sin, s_m, last, out }
    }

    /// One step towards the speed planned `look` steps ahead.
    #[inline]
    fn go(&mut self, scene: &Scene<'_>, look: usize, own: &Footprint) {
        let (dt_s, speed, [last, last_yaw_rate]) = (scene.dt_s, self.state.speed_mps, self.last);
        let beside = BesideLine::new(scene.line, self.s_m, &self.state);
        let planned_mps = self.planned_mps[self.out.actions.len() + look];
        let wanted = SHARE * (planned_mps - speed) / (look as Real * dt_s);
        let acceleration = last + dt_s / (dt_s + LAG_S) * (wanted - last);
        let (error_sin, error_cos) = math::sin_cos(beside.heading_error_rad);
        let yaw_rate = beside.steered(speed, self.proposal.offset_m, last_yaw_rate, dt_s, error_sin);
        self.last = [acceleration, yaw_rate];
        let action = [acceleration, yaw_rate, 0.0];
        Dynamics::default().advance(&mut self.state, self.cos, self.sin, action, dt_s, own);
        self.s_m += beside.ahead_m + 0.5 * (speed + self.state.speed_mps) * dt_s * error_cos;
        (self.sin, self.cos) = math::sin_cos(self.state.heading_rad);
        self.out.states.push(self.state);
        self.out.directions.push(Vector2::new(self.cos, self.sin));
        self.out.actions.push(self.last);
    }
}

/// Drives proposals against the forecast.
pub(super) fn roll(scene: &Scene<'_>, forecast: &Forecast, proposals: &[Proposal]) -> Vec<Rollout> {
    let (own, look) = (scene.footprint(scene.ego), (LOOK_S / scene.dt_s).round().max(1.0) as usize);
    let mut drives: Vec<_> = proposals.iter().map(|p| Drive::new(scene, forecast, p, look)).collect();
    for _ in 0..forecast.num_steps {
        for drive in &mut drives {
            drive.go(scene, look, own);
        }
    }
    let start_m = scene.place.s_m;
    let done = |drive: Drive<'_>| Rollout { progress_m: (drive.s_m - start_m).max(0.0), ..drive.out };
    drives.into_iter().map(done).collect()
}

/// x¹⁰, for [`IDM`]'s exponent.
fn tenth_power(x: Real) -> Real {
    let x2 = x * x;
    let x4 = x2 * x2;
    x4 * x4 * x2
}

impl Proposal {
    /// All of them.
    pub(super) fn all() -> Vec<Self> {
        OFFSETS_M
            .iter()
            .flat_map(|offset_m| SHARES.map(|share| Self { share, offset_m: *offset_m }))
            .collect()
    }

    /// Speeds that IDM plans along the line, m/s: now, after each step, and `more` steps further.
    fn speeds(&self, scene: &Scene<'_>, forecast: &Forecast, more: usize) -> Vec<Real> {
        let (line, own) = (scene.line, scene.footprint(scene.ego));
        let (mut s_m, mut speed) = (scene.place.s_m, scene.present().speed_mps);
        let mut speeds = vec![speed];
        for t in 0..forecast.num_steps + more {
            let boxes = forecast.beside(t.min(forecast.num_steps - 1));
            let limit = line.at(s_m).limit_mps.min(scene.speed_limit_mps);
            let wanted = (limit * self.share).min(line.at(s_m + 0.5 * speed).curve_speed_mps);
            let power = tenth_power(share_of(speed, wanted));
            let acceleration = idm_with(&IDM, speed, self.leader(boxes, s_m, own), power);
            s_m += speed * scene.dt_s;
            speed = (speed + acceleration * scene.dt_s).max(0.0);
            speeds.push(speed);
        }
        speeds
    }

    /// Gap to and speed of the nearest of some boxes in the way.
    #[inline]
    fn leader(&self, boxes: &[Beside], s_m: Real, own: &Footprint) -> Option<(Real, Real)> {
        let mut best: Option<(Real, Real)> = None;
        for b in boxes {
            if b.s_m <= s_m || (b.lateral_m - self.offset_m).abs() >= b.half_across_m + own.half_width_m {
                continue;
            }
            let gap_m = b.s_m - s_m - b.half_along_m - own.half_length_m;
            if best.is_none_or(|(least, _)| gap_m < least) {
                best = Some((gap_m, b.speed_mps));
            }
        }
        best
    }
}
