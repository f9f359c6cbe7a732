//! Assisted driving: a change of IDM's acceleration and a distance from the route.

use super::{Action, UnicycleLimits, is_positive, is_range};
use crate::geom::Real;
use serde::{Deserialize, Serialize};

/// Natural frequency of the return to the wanted distance from the route, rad/s; critically damped.
const FREQUENCY_RADPS: Real = 1.5;
/// Lateral acceleration spent on it at most, m/s².
const MAX_CORRECTION_MPS2: Real = 2.5;
/// Speeds below this count as this where the yaw rate follows from a lateral acceleration, m/s.
const LEAST_SPEED_MPS: Real = 2.0;

/// Limits of assisted driving.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AssistedLimits {
    /// Change of IDM's acceleration at −1 and +1, metres per second squared.
    pub delta_mps2: [Real; 2],
    /// Distance from the route at −1 and +1, metres, left positive.
    pub offset_m: [Real; 2],
    /// Lowest and highest acceleration, metres per second squared.
    pub acceleration_mps2: [Real; 2],
    /// The acceleration changes no faster than this, except where IDM brakes, metres per second cubed.
    pub max_jerk_mps3: Real,
    /// Lowest and highest speed, metres per second.
    pub speed_mps: [Real; 2],
}

impl Default for AssistedLimits {
    fn default() -> Self {
        Self {
            delta_mps2: [-6.0, 2.0],
            offset_m: [-1.5, 1.5],
            acceleration_mps2: [-8.0, 2.4],
            max_jerk_mps3: 8.0,
            speed_mps: [0.0, 30.0],
        }
    }
}

/// Where an agent is beside its route.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BesideRoute {
    /// Signed distance from the route, left positive, metres.
    pub(crate) distance_m: Real,
    /// Sine of the heading against the route's.
    pub(crate) sin: Real,
    /// Curvature of the route, left positive, 1/m.
    pub(crate) curvature_1pm: Real,
}

impl AssistedLimits {
    /// The unicycle that is driven.
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

    pub(super) fn first_fault(&self) -> Option<&'static str> {
        let about_zero = |range: [Real; 2]| is_range(range) && range[0] <= 0.0 && range[1] >= 0.0;
        [
            ("delta_mps2", about_zero(self.delta_mps2)),
            ("offset_m", about_zero(self.offset_m)),
            ("acceleration_mps2", about_zero(self.acceleration_mps2)),
            ("max_jerk_mps3", is_positive(self.max_jerk_mps3)),
            ("speed_mps", is_range(self.speed_mps)),
        ]
        .into_iter()
        .find_map(|(name, ok)| (!ok).then_some(name))
    }

    /// Acceleration of a step: IDM's and the wanted change, as far as the jerk allows. IDM's own braking is not held back.
    pub(crate) fn acceleration(
        &self,
        idm_mps2: Real,
        delta_mps2: Real,
        before_mps2: Real,
        dt_s: Real,
    ) -> Real {
        let step = self.max_jerk_mps3 * dt_s;
        let low = (before_mps2 - step).min(idm_mps2);
        (idm_mps2 + delta_mps2)
            .clamp(low, before_mps2 + step)
            .clamp(self.acceleration_mps2[0], self.acceleration_mps2[1])
    }

    /// Yaw rate that leads to a distance from the route: that of the route, and a critically damped return.
    pub(crate) fn yaw_rate(&self, at: &BesideRoute, offset_m: Real, speed_mps: Real) -> Real {
        let (f, lateral_mps) = (FREQUENCY_RADPS, speed_mps * at.sin);
        let wanted = f * f * (offset_m - at.distance_m) - 2.0 * f * lateral_mps;
        let correction = wanted.clamp(-MAX_CORRECTION_MPS2, MAX_CORRECTION_MPS2);
        at.curvature_1pm * speed_mps + correction / speed_mps.max(LEAST_SPEED_MPS)
    }
}
