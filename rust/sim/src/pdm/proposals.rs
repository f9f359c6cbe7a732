//! Proposals: a share of the speed limit and a distance from the centre line, rolled out with IDM and the unicycle.

use super::Scene;
use super::forecast::{Beside, Forecast, MOST_OFFSET_M};
use crate::drivers::{IdmConfig, idm_with, share_of};
use crate::dynamics::{KinState, UnicycleLimits};
use crate::geom::{Point2, Pose2, Real, Vector2, math};
use crate::simd_dispatch::simd_dispatch;
use crate::stage::CentreLine;

/// Shares of the speed limit, and distances from the centre line, metres.
pub(super) const SHARES: [Real; 5] = [0.2, 0.4, 0.6, 0.8, 1.0];
pub(super) const OFFSETS_M: [Real; 3] = [0.0, -MOST_OFFSET_M, MOST_OFFSET_M];
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

/// What a proposal would do.
#[derive(Debug, Clone)]
pub(super) struct Rollout {
    /// Poses and speeds, one more than steps.
    pub poses: Vec<Pose2>,
    pub speeds_mps: Vec<Real>,
    /// Acceleration and yaw rate of each step.
    pub actions: Vec<[Real; 2]>,
    /// Way along the line, metres.
    pub progress_m: Real,
    /// Distance from the line that it drives to, left positive, metres.
    pub offset_m: Real,
}

/// Yaw rate that follows a curve, critically damped in the distance from it. `error_sin`: of the heading from the curve's.
#[inline(always)]
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
    math::within(speed_mps * math::within(wanted, -most, most), -bound, bound)
}

/// The line around an arc length: of the two places nearest to it x, y, heading and curvature; cosine and sine of the first
/// heading; and the share of the second place there.
pub(super) type Near = [Real; 11];

#[inline(always)]
pub(super) fn near(line: &CentreLine, s_m: Real) -> Near {
    let (a, b, share) = line.around(s_m);
    let (p, q) = (&a.position, &b.position);
    let [h, c] = [[a.heading_rad, b.heading_rad], [a.curvature_1pm, b.curvature_1pm]];
    [p.x, q.x, p.y, q.y, h[0], h[1], c[0], c[1], a.direction.x, a.direction.y, share]
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
    #[inline(always)]
    pub(super) fn new(
        near: Near,
        state: &KinState,
        heading: Vector2,
        mut turned: impl FnMut(Vector2, Real) -> Vector2,
    ) -> Self {
        let [x0, x1, y0, y1, heading0, heading1, curvature0, curvature1, cos, sin, share] = near;
        let direction = turned(Vector2::new(cos, sin), share * (heading1 - heading0));
        let curvature_1pm = curvature0 + share * (curvature1 - curvature0);
        let (dx, dy) = (state.x - (x0 + (x1 - x0) * share), state.y - (y0 + (y1 - y0) * share));
        let ahead_m = dx * direction.x + dy * direction.y;
        let lateral_m = dy * direction.x - dx * direction.y;
        let error = Vector2::new(
            direction.x * heading.x + direction.y * heading.y,
            direction.x * heading.y - direction.y * heading.x,
        );
        Self { curvature_1pm, ahead_m, lateral_m, error: turned(error, -curvature_1pm * ahead_m) }
    }

    /// Yaw rate that leads to a distance from the line, after a yaw rate in the step before.
    #[inline(always)]
    pub(super) fn yaw_rate(
        &self,
        limits: &UnicycleLimits,
        speed_mps: Real,
        offset_m: Real,
        before_radps: Real,
        dt_s: Real,
    ) -> Real {
        let lateral_m = self.lateral_m - offset_m;
        let wanted = steering(limits, speed_mps, self.curvature_1pm, self.error.y, lateral_m);
        let change = YAW_ACCELERATION_RADPS2 * dt_s;
        math::within(wanted, before_radps - change, before_radps + change)
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
                let limit = line.around(*s_m).0.limit_mps.min(scene.speed_limit_mps);
                let (a, b, w) = line.around(*s_m + 0.5 * *speed);
                let wanted =
                    (limit * share).min(a.curve_speed_mps + w * (b.curve_speed_mps - a.curve_speed_mps));
                let leader = self.leader(t.min(last), *s_m, half_length_m);
                let leader = scene.held(leader, *s_m + half_length_m);
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
#[derive(Clone, Copy)]
struct Drive {
    state: KinState,
    heading: Vector2,
    s_m: Real,
    /// Acceleration and yaw rate of the last step.
    last: [Real; 2],
}

/// How a step is taken.
struct Pace {
    dt_s: Real,
    /// Time ahead of the planned speed, s.
    look_s: Real,
    limits: UnicycleLimits,
}

impl Drive {
    fn new(scene: &Scene<'_>) -> Self {
        let acceleration = scene.states.acceleration_mps2[scene.ego].clamp(-8.0, 4.0);
        let last = [acceleration, scene.states.yaw_rate_radps[scene.ego]];
        Self { state: scene.present(), heading: scene.heading(), s_m: scene.place.s_m, last }
    }

    #[inline(always)]
    fn from_numbers([x, y, heading_rad, speed_mps, cos, sin, s_m, a, w]: [Real; 9]) -> Self {
        let state = KinState { x, y, heading_rad, speed_mps };
        Self { state, heading: Vector2::new(cos, sin), s_m, last: [a, w] }
    }

    #[inline(always)]
    fn numbers(&self) -> [Real; 9] {
        let Self { state, heading, s_m, last: [a, w] } = self;
        [state.x, state.y, state.heading_rad, state.speed_mps, heading.x, heading.y, *s_m, *a, *w]
    }

    fn pose(&self) -> Pose2 {
        let Self { state: KinState { x, y, heading_rad, .. }, heading, .. } = *self;
        Pose2 { position: Point2::new(x, y), heading_rad, cos: heading.x, sin: heading.y }
    }

    /// Where it is after a step towards a planned speed and a distance from the line.
    #[inline(always)]
    fn after(
        self,
        pace: &Pace,
        near: Near,
        [planned_mps, offset_m]: [Real; 2],
        mut turned: impl FnMut(Vector2, Real) -> Vector2,
    ) -> Self {
        let (dt_s, [last, last_yaw_rate], speed) = (pace.dt_s, self.last, self.state.speed_mps);
        let beside = BesideLine::new(near, &self.state, self.heading, &mut turned);
        let wanted = SHARE * (planned_mps - speed) / pace.look_s;
        let acceleration = last + dt_s / (dt_s + LAG_S) * (wanted - last);
        let yaw_rate = beside.yaw_rate(&pace.limits, speed, offset_m, last_yaw_rate, dt_s);
        let mut state = self.state;
        pace.limits.advance(&mut state, self.heading, [acceleration, yaw_rate, 0.0], dt_s);
        let s_m = self.s_m + (beside.ahead_m + 0.5 * (speed + state.speed_mps) * dt_s * beside.error.x);
        let heading = turned(self.heading, state.heading_rad - self.state.heading_rad);
        Self { state, heading, s_m, last: [acceleration, yaw_rate] }
    }
}

/// Proposals side by side; the last lane repeats the last proposal.
const LANES: usize = 16;
type Lanes<const N: usize> = [[Real; LANES]; N];
/// Of [`Drive::numbers`].
const ARC_LENGTH: usize = 6;

#[inline(always)]
#[allow(clippy::needless_range_loop, reason = "iterators keep the loop of the caller from becoming vectors")]
fn lane<const N: usize>(lanes: &Lanes<N>, k: usize) -> [Real; N] {
    let mut numbers = [0.0; N];
    for i in 0..N {
        numbers[i] = lanes[i][k];
    }
    numbers
}

#[inline(always)]
#[allow(clippy::needless_range_loop, reason = "iterators keep the loop of the caller from becoming vectors")]
fn put<const N: usize>(lanes: &mut Lanes<N>, k: usize, numbers: [Real; N]) {
    for i in 0..N {
        lanes[i][k] = numbers[i];
    }
}

simd_dispatch! {
    /// One step of all proposals, and whether one of them turns so far that the series is not exact.
    fn step(
        pace: &Pace,
        drives: &Lanes<9>,
        places: &Lanes<11>,
        aims: &Lanes<2>,
        after: &mut Lanes<9>,
        is_wide: &mut bool,
    ) {
        // copies, so that the compiler knows that nothing overlaps
        let (drives, places, aims, mut wide) = (*drives, *places, *aims, false);
        let mut out = [[0.0; LANES]; 9];
        for k in 0..LANES {
            let drive = Drive::from_numbers(lane(&drives, k));
            let drive = drive.after(pace, lane(&places, k), lane(&aims, k), |direction, angle_rad| {
                wide |= !math::is_small(angle_rad);
                math::turned_a_little(direction, angle_rad)
            });
            put(&mut out, k, drive.numbers());
        }
        (*after, *is_wide) = (out, wide);
    }
}

/// Rolls out all proposals against the forecast. Distances with the same boxes in the way share their planned speeds.
pub(super) fn roll(scene: &Scene<'_>, forecast: &Forecast) -> Vec<Rollout> {
    let own = scene.footprint(scene.ego);
    let look = (LOOK_S / scene.dt_s).round().max(1.0) as usize;
    let mut planned: Vec<(Way, [Vec<Real>; SHARES.len()])> = Vec::with_capacity(OFFSETS_M.len());
    let of_offset = OFFSETS_M.map(|offset_m| {
        let way = Way::new(forecast, offset_m, own.half_width_m);
        let known = planned.iter().position(|(known, _)| *known == way).unwrap_or_else(|| {
            let speeds = way.speeds(scene, look);
            planned.push((way, speeds));
            planned.len() - 1
        });
        (offset_m, known)
    });
    let of_way = |(offset_m, known): (Real, usize)| {
        planned[known].1.iter().map(move |speeds| (offset_m, &speeds[look..]))
    };
    let proposals: Vec<(Real, &[Real])> = of_offset.into_iter().flat_map(of_way).collect();
    let pace =
        Pace { dt_s: scene.dt_s, look_s: look as Real * scene.dt_s, limits: UnicycleLimits::default() };
    let mut track = vec![Drive::new(scene).numbers().map(|number| [number; LANES]); forecast.num_steps + 1];
    let (mut places, mut aims, mut is_wide) = ([[0.0; LANES]; 11], [[0.0; LANES]; 2], false);
    for t in 0..forecast.num_steps {
        let [drives, after] = &mut track[t..t + 2] else { unreachable!("one more than steps") };
        for k in 0..LANES {
            let (offset_m, speeds) = proposals[k.min(proposals.len() - 1)];
            put(&mut places, k, near(scene.line, drives[ARC_LENGTH][k]));
            put(&mut aims, k, [speeds[t], offset_m]);
        }
        step(&pace, drives, &places, &aims, after, &mut is_wide);
        if is_wide {
            // once more, for turns of any size
            for k in 0..LANES {
                let drive = Drive::from_numbers(lane(drives, k));
                put(after, k, drive.after(&pace, lane(&places, k), lane(&aims, k), math::turned).numbers());
            }
        }
    }
    let rollout = |(k, (offset_m, _)): (usize, &(Real, &[Real]))| {
        let drives = || track.iter().map(|lanes| Drive::from_numbers(lane(lanes, k)));
        Rollout {
            poses: drives().map(|drive| drive.pose()).collect(),
            speeds_mps: drives().map(|drive| drive.state.speed_mps).collect(),
            actions: drives().skip(1).map(|drive| drive.last).collect(),
            progress_m: (track[forecast.num_steps][ARC_LENGTH][k] - scene.place.s_m).max(0.0),
            offset_m: *offset_m,
        }
    };
    proposals.iter().enumerate().map(rollout).collect()
}

/// x¹⁰, for [`IDM`]'s exponent.
fn tenth_power(x: Real) -> Real {
    let x2 = x * x;
    let x4 = x2 * x2;
    x4 * x4 * x2
}
