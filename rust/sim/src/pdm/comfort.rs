//! Comfort of a rollout: nuPlan's six limits, taken of motion that is smoothed as the original's scorer does.

use super::proposals::Rollout;
use crate::events::limits;
use crate::geom::Real;

/// Whether a rollout that begins with an acceleration stays within all limits.
pub(super) fn is_calm(rollout: &Rollout, acceleration_mps2: Real, dt_s: Real) -> bool {
    let ahead = || std::iter::once(acceleration_mps2).chain(rollout.actions.iter().map(|[a, _]| *a));
    let [least, most] = limits::ACCELERATION_MPS2;
    let fit = Parabola::new(ahead());
    let sideways = |([_, rate], speed_mps): (&[Real; 2], &Real)| (rate * speed_mps).abs();
    fit.values().all(|a| a > least && a < most)
        && rollout
            .actions
            .iter()
            .zip(&rollout.speeds_mps)
            .map(sideways)
            .all(|a| a < limits::LATERAL_ACCELERATION_MPS2)
        && fit.steepest() < limits::LONGITUDINAL_JERK_MPS3 * dt_s
        && Parabola::new(ahead().map(Real::abs)).steepest() < limits::JERK_MPS3 * dt_s
        && turns_calmly(rollout, dt_s)
}

/// Yaw rate and acceleration within their limits: derivatives through five headings (Savitzky and Golay 1964).
fn turns_calmly(rollout: &Rollout, dt_s: Real) -> bool {
    let last = rollout.poses.len().saturating_sub(5);
    let (most_rate, most_change) =
        (limits::YAW_RATE_RADPS * dt_s, limits::YAW_ACCELERATION_RADPS2 * dt_s * dt_s);
    rollout.poses.windows(5).enumerate().all(|(i, five)| {
        let h = |k: usize| five[k].heading_rad - five[2].heading_rad;
        let rate = (2.0 * (h(4) - h(0)) + h(3) - h(1)) / 10.0;
        let bend = (2.0 * (h(0) + h(4)) - h(1) - h(3)) / 7.0;
        let change = 0.5 * (h(4) - h(0)) - h(3) + h(1);
        let from = if i == 0 { -2 } else { 0 };
        let to = if i == last { 2 } else { 0 };
        (from..=to).all(|k| {
            let k = k as Real;
            (rate + k * bend).abs() < most_rate && (bend + k * change).abs() < most_change
        })
    })
}

/// The parabola of least squares through evenly spaced numbers.
struct Parabola {
    n: usize,
    mean: Real,
    slope: Real,
    bend: Real,
}

impl Parabola {
    fn new(numbers: impl Iterator<Item = Real> + Clone) -> Self {
        let n = numbers.clone().count();
        let mut found = Self { n, mean: 0.0, slope: 0.0, bend: 0.0 };
        let (mut of_slope, mut of_bend) = (0.0, 0.0);
        for (i, x) in numbers.enumerate() {
            let (u, w) = found.at(i);
            found.mean += x;
            found.slope += x * u;
            found.bend += x * w;
            of_slope += u * u;
            of_bend += w * w;
        }
        found.mean /= n as Real;
        found.slope /= Real::max(of_slope, Real::MIN_POSITIVE);
        found.bend /= Real::max(of_bend, Real::MIN_POSITIVE);
        found
    }

    /// Place of a number from the middle, and the polynomial of second degree that is orthogonal to it and to 1.
    fn at(&self, i: usize) -> (Real, Real) {
        let n = self.n as Real;
        let u = i as Real - 0.5 * (n - 1.0);
        (u, u * u - (n * n - 1.0) / 12.0)
    }

    fn values(&self) -> impl Iterator<Item = Real> + '_ {
        (0..self.n).map(|i| {
            let (u, w) = self.at(i);
            self.mean + self.slope * u + self.bend * w
        })
    }

    /// Greatest slope, up or down, per number.
    fn steepest(&self) -> Real {
        self.slope.abs() + (self.bend * (self.n as Real - 1.0)).abs()
    }
}
