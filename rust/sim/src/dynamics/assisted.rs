//! Assisted driving: a change of a driver's acceleration and a distance from its way.

use super::{Action, UnicycleLimits};
use crate::geom::Real;
use crate::options::{MOTION, within};
use crate::{choices, options};

/// Natural frequency of the return to the wanted distance from the route, rad/s; critically damped.
const FREQUENCY_RADPS: Real = 1.5;
/// Lateral acceleration spent on it at most, m/s².
const MAX_CORRECTION_MPS2: Real = 2.5;
/// Speeds below this count as this where the yaw rate follows from a lateral acceleration, m/s.
const LEAST_SPEED_MPS: Real = 2.0;

choices! {
    /// Rule whose driving the actions change.
    #[derive(Clone, Copy, Eq)]
    pub enum AssistedBase {
        /// IDM on the route.
        Idm = "idm",
        /// PDM-Closed on its centre line, asked at every step.
        Pdm = "pdm",
    }
}

options! {
    /// Limits of assisted driving: actions change what IDM or PDM-Closed would do.
    ///
    /// The vehicle is a unicycle with the acceleration of its base plus a change, steered to a distance from its base's path;
    /// the zero action is the base.
    #[derive(Clone, Copy)]
    #[serde(deny_unknown_fields, default)]
    pub struct AssistedLimits {
        /// The rule that is changed.
        base: AssistedBase = AssistedBase::Idm;
        /// Change of the acceleration at -1 and +1, about zero.
        delta_mps2: [Real; 2] = [-6.0, 2.0], unit "m/s²", range MOTION;
        /// Distance from the path at -1 and +1, left positive, about zero.
        offset_m: [Real; 2] = [-1.5, 1.5], unit "m", range MOTION;
        /// Lowest and highest acceleration, about zero.
        acceleration_mps2: [Real; 2] = [-8.0, 2.4], unit "m/s²", range MOTION;
        /// The acceleration changes no faster than this, except down to that of the base, or up to that of PDM.
        max_jerk_mps3: Real = 8.0, unit "m/s³", range within(0.0, 1000.0).open_below();
        /// The base's own acceleration changes no faster than this, except where it brakes harder than nuPlan's comfort
        /// allows, 4.05 m/s².
        base_jerk_mps3: Real = 1000.0, unit "m/s³", range within(0.0, 1000.0).open_below();
        /// Lowest and highest speed.
        speed_mps: [Real; 2] = [0.0, 30.0], unit "m/s", range MOTION;
    }
}

impl AssistedLimits {
    pub(super) fn unicycle(&self) -> UnicycleLimits {
        UnicycleLimits {
            acceleration_mps2: self.acceleration_mps2,
            speed_mps: self.speed_mps,
            ..UnicycleLimits::default()
        }
    }

    pub(super) fn action_bounds(&self) -> (Action, Action) {
        ([self.delta_mps2[0], self.offset_m[0], 0.0], [self.delta_mps2[1], self.offset_m[1], 0.0])
    }

    /// The first of the ranges about zero that is not, by its name.
    pub(crate) fn off_zero(&self) -> Option<(&'static str, [Real; 2])> {
        let ranges = [
            ("delta_mps2", self.delta_mps2),
            ("offset_m", self.offset_m),
            ("acceleration_mps2", self.acceleration_mps2),
        ];
        ranges.into_iter().find(|(_, [low, high])| *low > 0.0 || *high < 0.0)
    }

    /// Acceleration of a step: base plus change, within the jerk; the base brakes at once, and PDM also stops braking.
    pub(crate) fn acceleration(
        &self,
        base_mps2: Real,
        delta_mps2: Real,
        before_mps2: Real,
        dt_s: Real,
    ) -> Real {
        let step = self.max_jerk_mps3 * dt_s;
        let low = (before_mps2 - step).min(base_mps2);
        let high = match self.base {
            AssistedBase::Idm => before_mps2 + step,
            AssistedBase::Pdm => (before_mps2 + step).max(base_mps2),
        };
        (base_mps2 + delta_mps2).clamp(low, high).clamp(self.acceleration_mps2[0], self.acceleration_mps2[1])
    }
}

/// Yaw rate that corrects a distance from a route, left positive: that of its curvature, and a critically damped return.
/// `error_sin`: of the heading from the route's.
pub(crate) fn yaw_rate(distance_m: Real, error_sin: Real, curvature_1pm: Real, speed_mps: Real) -> Real {
    let (f, lateral_mps) = (FREQUENCY_RADPS, speed_mps * error_sin);
    let wanted = f * f * -distance_m - 2.0 * f * lateral_mps;
    let correction = wanted.clamp(-MAX_CORRECTION_MPS2, MAX_CORRECTION_MPS2);
    curvature_1pm * speed_mps + correction / speed_mps.max(LEAST_SPEED_MPS)
}
