//! Proposals: a share of the speed limit and a distance from the centre line, rolled out with IDM and the unicycle.

use super::Scene;
use super::forecast::Forecast;
use crate::dynamics::{Dynamics, KinState, UnicycleLimits};
use crate::geom::{Real, Vector2, math};
use crate::policy::{IdmConfig, idm_towards};
use crate::stage::{CentreLine, Place};

/// Shares of the speed limit, and distances from the centre line, metres.
const SHARES: [Real; 5] = [0.2, 0.4, 0.6, 0.8, 1.0];
const OFFSETS_M: [Real; 3] = [0.0, -1.0, 1.0];
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
/// Changes of acceleration and of yaw rate that the tracker makes, m/s³ and rad/s².
const JERK_MPS3: Real = 8.0;
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
    let length_m = (0.7 * speed_mps).max(3.0);
    let (sin, _) = math::sin_cos(heading_error_rad);
    let wanted = curvature_1pm - 2.0 / length_m * sin - lateral_m.clamp(-1.5, 1.5) / (length_m * length_m);
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
        let (curvature_1pm, lateral_m) = (self.at.curvature_1pm, self.lateral_m - offset_m);
        let limits = UnicycleLimits::default();
        let wanted = steering(&limits, speed_mps, curvature_1pm, self.heading_error_rad, lateral_m);
        let change = YAW_ACCELERATION_RADPS2 * dt_s;
        wanted.clamp(before_radps - change, before_radps + change)
    }
}

impl Proposal {
    /// All of them.
    pub(super) fn all() -> Vec<Self> {
        OFFSETS_M
            .iter()
            .flat_map(|offset_m| SHARES.map(|share| Self { share, offset_m: *offset_m }))
            .collect()
    }

    /// Drives it against the forecast.
    pub(super) fn roll(&self, scene: &Scene<'_>, forecast: &Forecast) -> Rollout {
        let (line, dt_s, own) = (scene.line, scene.dt_s, scene.footprint(scene.ego));
        let dynamics = Dynamics::default();
        let mut state = scene.present();
        let start_m = scene.place.s_m;
        let mut s_m = start_m;
        let mut last = scene.states.acceleration_mps2[scene.ego].clamp(-8.0, 4.0);
        let mut last_yaw_rate = scene.states.yaw_rate_radps[scene.ego];
        let direction = |state: &KinState| {
            let (sin, cos) = math::sin_cos(state.heading_rad);
            Vector2::new(cos, sin)
        };
        let mut out = Rollout {
            states: vec![state],
            directions: vec![direction(&state)],
            actions: Vec::with_capacity(forecast.num_steps),
            progress_m: 0.0,
        };
        for t in 0..forecast.num_steps {
            let beside = BesideLine::new(line, s_m, &state);
            s_m += beside.ahead_m;
            let speed = state.speed_mps;
            let limit = beside.at.limit_mps.min(scene.speed_limit_mps);
            let wanted = (limit * self.share).min(line.at(s_m + 0.5 * speed).curve_speed_mps);
            let leader = self.leader(forecast, t, s_m, own.half_length_m, own.half_width_m);
            let wanted = idm_towards(&IDM, speed, wanted, leader);
            let change = JERK_MPS3 * dt_s;
            let acceleration = wanted.clamp(last - change, last + change);
            let yaw_rate = beside.yaw_rate(speed, self.offset_m, last_yaw_rate, dt_s);
            let before = state;
            dynamics.step(&mut state, [acceleration, yaw_rate, 0.0], dt_s, own);
            s_m +=
                0.5 * (before.speed_mps + state.speed_mps) * dt_s * math::sin_cos(beside.heading_error_rad).1;
            (last, last_yaw_rate) = (acceleration, yaw_rate);
            out.states.push(state);
            out.directions.push(direction(&state));
            out.actions.push([acceleration, yaw_rate]);
        }
        out.progress_m = (s_m - start_m).max(0.0);
        out
    }

    /// Gap to and speed of the nearest box in the way at a step.
    fn leader(
        &self,
        forecast: &Forecast,
        step: usize,
        s_m: Real,
        half_length_m: Real,
        half_width_m: Real,
    ) -> Option<(Real, Real)> {
        let mut best: Option<(Real, Real)> = None;
        for other in &forecast.others {
            let b = &other.beside[step];
            if b.s_m <= s_m || (b.lateral_m - self.offset_m).abs() >= b.half_across_m + half_width_m {
                continue;
            }
            let gap_m = b.s_m - s_m - b.half_along_m - half_length_m;
            if best.is_none_or(|(least, _)| gap_m < least) {
                best = Some((gap_m, b.speed_mps));
            }
        }
        best
    }
}
