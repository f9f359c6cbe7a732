//! Unicycle: acceleration and yaw rate.

use super::{Action, KinState};
use crate::geom::{Real, Vector2, math};
use crate::options;
use crate::options::{MOTION, POSITIVE_MOTION, within};
use std::f32::consts::TAU;

options! {
    /// Limits of the unicycle: actions are acceleration (m/s²) and yaw rate (rad/s). The defaults are those of the released
    /// models of traffic (reference.md, dynamics), but for the reverse gear.
    #[derive(Clone, Copy)]
    #[serde(deny_unknown_fields, default)]
    pub struct UnicycleLimits {
        /// Lowest and highest acceleration.
        acceleration_mps2: [Real; 2] = [-10.0, 8.0], unit "m/s²", range MOTION;
        /// Lowest and highest speed. Vehicles brake to a stop and do not reverse.
        speed_mps: [Real; 2] = [0.0, 30.0], unit "m/s", range MOTION;
        /// Yaw rate that is allowed at any speed.
        min_yaw_rate_radps: Real = 0.1, unit "rad/s", range within(0.0, 10.0).open_below();
        /// Highest yaw rate per speed, a curvature.
        max_curvature_1pm: Real = 0.5, unit "1/m", range within(0.0, 10.0).open_below();
        /// Highest yaw rate times speed.
        max_lateral_acceleration_mps2: Real = TAU, unit "m/s²", range POSITIVE_MOTION;
        /// The acceleration of an agent of a world changes no faster than this.
        max_jerk_mps3: Real = 1000.0, unit "m/s³", range within(0.0, 1000.0).open_below();
        /// The yaw rate of an agent of a world changes no faster than this, but for the limits above.
        max_yaw_acceleration_radps2: Real = 1000.0, unit "rad/s²", range within(0.0, 1000.0).open_below();
    }
}

impl UnicycleLimits {
    /// Speed below which the bound by lateral acceleration stays what it is there, m/s.
    pub const LEAST_PACE_MPS: Real = 0.1;

    /// Highest yaw rate at a speed, radians per second.
    #[inline(always)]
    pub fn yaw_rate_bound(&self, speed_mps: Real) -> Real {
        let speed = speed_mps.abs();
        let by_speed = (self.max_curvature_1pm * speed)
            .min(self.max_lateral_acceleration_mps2 / speed.max(Self::LEAST_PACE_MPS));
        by_speed.max(self.min_yaw_rate_radps)
    }

    /// The action as far as an agent with this acceleration and yaw rate can take it within a step.
    #[inline(always)]
    pub(super) fn within_reach(&self, action: Action, rates: [Real; 2], dt_s: Real) -> Action {
        let (low, high) = self.action_bounds();
        let changes = [self.max_jerk_mps3 * dt_s, self.max_yaw_acceleration_radps2 * dt_s];
        let reach = |i: usize| {
            let from = math::within(rates[i], low[i], high[i]);
            math::within(action[i], from - changes[i], from + changes[i])
        };
        [reach(0), reach(1), 0.0]
    }

    pub(super) fn action_bounds(&self) -> (Action, Action) {
        // the two bounds on the yaw rate meet at the speed sqrt(a_lat / kappa)
        let yaw_rate =
            (self.max_curvature_1pm * self.max_lateral_acceleration_mps2).sqrt().max(self.min_yaw_rate_radps);
        ([self.acceleration_mps2[0], -yaw_rate, 0.0], [self.acceleration_mps2[1], yaw_rate, 0.0])
    }

    #[inline(always)]
    pub(crate) fn advance(&self, state: &mut KinState, heading: Vector2, action: Action, dt_s: Real) -> Real {
        let acceleration = math::within(action[0], self.acceleration_mps2[0], self.acceleration_mps2[1]);
        let next_speed =
            math::within(state.speed_mps + acceleration * dt_s, self.speed_mps[0], self.speed_mps[1]);
        let bound = self.yaw_rate_bound(state.speed_mps);
        let distance = 0.5 * (state.speed_mps + next_speed) * dt_s;
        state.x += distance * heading.x;
        state.y += distance * heading.y;
        state.heading_rad += math::within(action[1], -bound, bound) * dt_s;
        state.speed_mps = next_speed;
        0.0
    }
}
