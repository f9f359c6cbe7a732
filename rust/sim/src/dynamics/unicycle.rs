//! Unicycle: acceleration and yaw rate.

use super::{Action, KinState, Motion, is_positive, is_range};
use crate::geom::Real;
use serde::{Deserialize, Serialize};
use std::f32::consts::TAU;

/// Limits of the unicycle; the defaults are those of the released models of traffic (reference.md, dynamics).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct UnicycleLimits {
    /// Lowest and highest acceleration, metres per second squared.
    pub acceleration_mps2: [Real; 2],
    /// Lowest and highest speed, metres per second.
    pub speed_mps: [Real; 2],
    /// Yaw rate that is allowed at any speed, radians per second.
    pub min_yaw_rate_radps: Real,
    /// Highest yaw rate per speed, 1/metres (a curvature).
    pub max_curvature_1pm: Real,
    /// Highest yaw rate times speed, metres per second squared.
    pub max_lateral_acceleration_mps2: Real,
}

impl Default for UnicycleLimits {
    fn default() -> Self {
        Self {
            acceleration_mps2: [-10.0, 8.0],
            speed_mps: [-10.0, 30.0],
            min_yaw_rate_radps: 0.1,
            max_curvature_1pm: 0.5,
            max_lateral_acceleration_mps2: TAU,
        }
    }
}

impl UnicycleLimits {
    /// Highest yaw rate at a speed, radians per second.
    #[inline]
    pub fn yaw_rate_bound(&self, speed_mps: Real) -> Real {
        let speed = speed_mps.abs();
        let by_speed =
            (self.max_curvature_1pm * speed).min(self.max_lateral_acceleration_mps2 / speed.max(0.1));
        by_speed.max(self.min_yaw_rate_radps)
    }

    pub(super) fn action_bounds(&self) -> (Action, Action) {
        // the two bounds on the yaw rate meet at the speed sqrt(a_lat / kappa)
        let yaw_rate =
            (self.max_curvature_1pm * self.max_lateral_acceleration_mps2).sqrt().max(self.min_yaw_rate_radps);
        ([self.acceleration_mps2[0], -yaw_rate, 0.0], [self.acceleration_mps2[1], yaw_rate, 0.0])
    }

    pub(super) fn first_fault(&self) -> Option<&'static str> {
        [
            ("acceleration_mps2", is_range(self.acceleration_mps2)),
            ("speed_mps", is_range(self.speed_mps)),
            ("min_yaw_rate_radps", is_positive(self.min_yaw_rate_radps)),
            ("max_curvature_1pm", is_positive(self.max_curvature_1pm)),
            ("max_lateral_acceleration_mps2", is_positive(self.max_lateral_acceleration_mps2)),
        ]
        .into_iter()
        .find_map(|(name, ok)| (!ok).then_some(name))
    }

    #[inline]
    pub(super) fn advance(
        &self,
        state: &mut KinState,
        cos: Real,
        sin: Real,
        action: Action,
        dt_s: Real,
    ) -> Motion {
        let acceleration = action[0].clamp(self.acceleration_mps2[0], self.acceleration_mps2[1]);
        let next_speed = (state.speed_mps + acceleration * dt_s).clamp(self.speed_mps[0], self.speed_mps[1]);
        let bound = self.yaw_rate_bound(state.speed_mps);
        let distance = 0.5 * (state.speed_mps + next_speed) * dt_s;
        state.x += distance * cos;
        state.y += distance * sin;
        state.heading_rad += action[1].clamp(-bound, bound) * dt_s;
        state.speed_mps = next_speed;
        Motion { lateral_mps: 0.0 }
    }
}
