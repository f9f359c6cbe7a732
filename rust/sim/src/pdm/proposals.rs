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
    /// Distance from the line that it drives to, left positive, metres.
    pub offset_m: Real,
}

/// Yaw rate that follows a curve, critically damped in the distance from it. `error_sin`: of the heading from the curve's.
#[inline]
pub(crate) fn steering(
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
    curvature_1pm: Real,
    /// Along the line from there, and left of it, metres.
    ahead_m: Real,
    lateral_m: Real,
    /// Cosine and sine of the heading from the line's.
    error: Vector2,
}

impl BesideLine {
    #[inline]
    pub(super) fn new(line: &CentreLine, s_m: Real, state: &KinState, heading: Vector2) -> Self {
        let Place { position, direction, curvature_1pm, .. } = line.at(s_m);
        let (dx, dy) = (state.x - position.x, state.y - position.y);
        let ahead_m = dx * direction.x + dy * direction.y;
        let lateral_m = dy * direction.x - dx * direction.y;
        let error = Vector2::new(direction.dot(&heading), direction.x * heading.y - direction.y * heading.x);
        Self { curvature_1pm, ahead_m, lateral_m, error: math::turned(error, -curvature_1pm * ahead_m) }
    }

    /// Yaw rate that leads to a distance from the line, after a yaw rate in the step before.
    #[inline]
    pub(super) fn yaw_rate(&self, speed_mps: Real, offset_m: Real, before_radps: Real, dt_s: Real) -> Real {
        let (limits, lateral_m) = (UnicycleLimits::default(), self.lateral_m - offset_m);
        let wanted = steering(&limits, speed_mps, self.curvature_1pm, self.error.y, lateral_m);
        let change = YAW_ACCELERATION_RADPS2 * dt_s;
        wanted.clamp(before_radps - change, before_radps + change)
    }
}

/// Boxes in the way at a distance from the centre line, step after step.
#[derive(PartialEq)]
struct Way {
    boxes: Vec<Beside>,
    ends: Vec<usize>,
}

impl Way {
    fn new(forecast: &Forecast, offset_m: Real, half_width_m: Real) -> Self {
        let mut found = Self { boxes: Vec::new(), ends: Vec::with_capacity(forecast.num_steps) };
        let is_in_way = |b: &&Beside| (b.lateral_m - offset_m).abs() < b.half_across_m + half_width_m;
        for t in 0..forecast.num_steps {
            found.boxes.extend(forecast.beside(t).iter().filter(is_in_way));
            found.ends.push(found.boxes.len());
        }
        found
    }

    /// Gap to and speed of the nearest box ahead at a step.
    #[inline]
    fn leader(&self, step: usize, s_m: Real, half_length_m: Real) -> Option<(Real, Real)> {
        let first = if step == 0 { 0 } else { self.ends[step - 1] };
        let mut best: Option<(Real, Real)> = None;
        for b in &self.boxes[first..self.ends[step]] {
            let gap_m = b.s_m - s_m - b.half_along_m - half_length_m;
            if b.s_m > s_m && best.is_none_or(|(least, _)| gap_m < least) {
                best = Some((gap_m, b.speed_mps));
            }
        }
        best
    }

    /// Speeds that IDM plans along the line for each share of the limit, m/s: now, after each step, and `more` steps further.
    fn speeds(&self, scene: &Scene<'_>, more: usize) -> [Vec<Real>; SHARES.len()] {
        let (line, half_length_m) = (scene.line, scene.footprint(scene.ego).half_length_m);
        let last = self.ends.len() - 1;
        let mut speeds = SHARES.map(|_| Vec::with_capacity(last + more + 2));
        let mut now = [(scene.place.s_m, scene.present().speed_mps); SHARES.len()];
        speeds.iter_mut().zip(&now).for_each(|(speeds, (_, speed))| speeds.push(*speed));
        for t in 0..=last + more {
            for ((share, speeds), (s_m, speed)) in SHARES.iter().zip(&mut speeds).zip(&mut now) {
                let limit = line.at(*s_m).limit_mps.min(scene.speed_limit_mps);
                let wanted = (limit * share).min(line.at(*s_m + 0.5 * *speed).curve_speed_mps);
                let leader = self.leader(t.min(last), *s_m, half_length_m);
                let acceleration = idm_with(&IDM, *speed, leader, tenth_power(share_of(*speed, wanted)));
                *s_m += *speed * scene.dt_s;
                *speed = (*speed + acceleration * scene.dt_s).max(0.0);
                speeds.push(*speed);
            }
        }
        speeds
    }
}

/// A proposal on its way.
struct Drive<'a> {
    /// Speeds of [`Way::speeds`].
    planned_mps: &'a [Real],
    state: KinState,
    heading: Vector2,
    s_m: Real,
    /// Acceleration and yaw rate of the last step.
    last: [Real; 2],
    out: Rollout,
}

impl<'a> Drive<'a> {
    fn new(scene: &Scene<'_>, offset_m: Real, planned_mps: &'a [Real], num_steps: usize) -> Self {
        let (state, heading) = (scene.present(), scene.heading());
        let acceleration = scene.states.acceleration_mps2[scene.ego].clamp(-8.0, 4.0);
        let last = [acceleration, scene.states.yaw_rate_radps[scene.ego]];
        let mut out = Rollout {
            states: Vec::with_capacity(num_steps + 1),
            directions: Vec::with_capacity(num_steps + 1),
            actions: Vec::with_capacity(num_steps),
            progress_m: 0.0,
            offset_m,
        };
        out.states.push(state);
        out.directions.push(heading);
        Self { planned_mps, state, heading, s_m: scene.place.s_m, last, out }
    }

    /// One step towards the speed planned `look` steps ahead.
    #[inline]
    fn go(&mut self, scene: &Scene<'_>, look: usize, own: &Footprint) {
        let (dt_s, before, [last, last_yaw_rate]) = (scene.dt_s, self.state, self.last);
        let (speed, beside) =
            (before.speed_mps, BesideLine::new(scene.line, self.s_m, &before, self.heading));
        let planned_mps = self.planned_mps[self.out.actions.len() + look];
        let wanted = SHARE * (planned_mps - speed) / (look as Real * dt_s);
        let acceleration = last + dt_s / (dt_s + LAG_S) * (wanted - last);
        self.last = [acceleration, beside.yaw_rate(speed, self.out.offset_m, last_yaw_rate, dt_s)];
        let action = [acceleration, self.last[1], 0.0];
        Dynamics::default().advance(&mut self.state, self.heading.x, self.heading.y, action, dt_s, own);
        self.s_m += beside.ahead_m + 0.5 * (speed + self.state.speed_mps) * dt_s * beside.error.x;
        self.heading = math::turned(self.heading, self.state.heading_rad - before.heading_rad);
        self.out.states.push(self.state);
        self.out.directions.push(self.heading);
        self.out.actions.push(self.last);
    }
}

/// Drives [`Proposal::all`] against the forecast. The speeds planned for two distances from the line are the same where the
/// same boxes are in the way.
pub(super) fn roll(scene: &Scene<'_>, forecast: &Forecast) -> Vec<Rollout> {
    let (own, look) = (scene.footprint(scene.ego), (LOOK_S / scene.dt_s).round().max(1.0) as usize);
    let mut planned: Vec<(Way, [Vec<Real>; SHARES.len()])> = Vec::with_capacity(OFFSETS_M.len());
    let of_offset = OFFSETS_M.map(|offset_m| {
        let way = Way::new(forecast, offset_m, own.half_width_m);
        planned.iter().position(|(known, _)| *known == way).unwrap_or_else(|| {
            let speeds = way.speeds(scene, look);
            planned.push((way, speeds));
            planned.len() - 1
        })
    });
    let speeds = of_offset.iter().flat_map(|i| &planned[*i].1);
    let mut drives: Vec<_> = Proposal::all()
        .zip(speeds)
        .map(|(p, speeds)| Drive::new(scene, p.offset_m, speeds, forecast.num_steps))
        .collect();
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
    pub(super) fn all() -> impl Iterator<Item = Self> {
        OFFSETS_M.into_iter().flat_map(|offset_m| SHARES.map(|share| Self { share, offset_m }))
    }
}
