//! Kinematic bicycle: acceleration and steering angle.

use super::{Action, KinState};
use crate::geom::{Real, Vector2, math};
use crate::options;
use crate::options::{MOTION, POSITIVE_MOTION, within};
use crate::state::Footprint;
use std::f32::consts::TAU;

/// Below this speed the heading says nothing about the steering angle, metres per second.
const MIN_STEERED_SPEED_MPS: Real = 1e-3;

options! {
    /// Limits of the kinematic bicycle: actions are acceleration (m/s²) and steering angle (rad).
    #[derive(Clone, Copy)]
    #[serde(deny_unknown_fields, default)]
    pub struct BicycleLimits {
        /// Lowest and highest acceleration.
        acceleration_mps2: [Real; 2] = [-10.0, 8.0], unit "m/s²", range MOTION;
        /// Lowest and highest speed along the heading. Vehicles brake to a stop and do not reverse.
        speed_mps: [Real; 2] = [0.0, 30.0], unit "m/s", range MOTION;
        /// Largest steering angle of the front wheel, below π/2.
        max_steering_rad: Real = 0.6, unit "rad", range within(0.0, 1.57).open_below();
        /// Highest yaw rate times speed.
        max_lateral_acceleration_mps2: Real = TAU, unit "m/s²", range POSITIVE_MOTION;
        /// Wheelbase as a share of the length. 0.6 fits passenger cars: nuPlan's Pacifica has 3.089 m of 5.176 m.
        wheelbase_share: Real = 0.6, range within(0.0, 1.0).open_below();
    }
}

impl BicycleLimits {
    /// Distance between the axles of a body, metres. The centre of the box lies midway.
    #[inline]
    pub fn wheelbase_m(&self, footprint: &Footprint) -> Real {
        2.0 * footprint.half_length_m * self.wheelbase_share
    }

    pub(super) fn action_bounds(&self) -> (Action, Action) {
        (
            [self.acceleration_mps2[0], -self.max_steering_rad, 0.0],
            [self.acceleration_mps2[1], self.max_steering_rad, 0.0],
        )
    }

    /// Yaw rate at a speed and steering angle, within the lateral limit, radians per second.
    #[inline]
    fn yaw_rate(&self, speed_mps: Real, curvature_1pm: Real) -> Real {
        let bound = self.max_lateral_acceleration_mps2 / speed_mps.abs().max(0.1);
        (speed_mps * curvature_1pm).clamp(-bound, bound)
    }

    #[inline]
    pub(super) fn advance(
        &self,
        state: &mut KinState,
        heading: Vector2,
        action: Action,
        dt_s: Real,
        footprint: &Footprint,
    ) -> Real {
        let acceleration = action[0].clamp(self.acceleration_mps2[0], self.acceleration_mps2[1]);
        let steering = action[1].clamp(-self.max_steering_rad, self.max_steering_rad);
        let wheelbase_m = self.wheelbase_m(footprint);
        let curvature = math::tan(steering) / wheelbase_m;
        let next_speed = (state.speed_mps + acceleration * dt_s).clamp(self.speed_mps[0], self.speed_mps[1]);
        let mean_speed = 0.5 * (state.speed_mps + next_speed);
        let yaw_rate = self.yaw_rate(mean_speed, curvature);
        // heading midway through the step, by turning the known direction
        let (turn_sin, turn_cos) = math::sin_cos(0.5 * yaw_rate * dt_s);
        let [cos, sin] = heading.into();
        let (mid_cos, mid_sin) = (cos * turn_cos - sin * turn_sin, sin * turn_cos + cos * turn_sin);
        let rear_m = 0.5 * wheelbase_m;
        let (along, left) = (mean_speed * dt_s, yaw_rate * rear_m * dt_s);
        state.x += along * mid_cos - left * mid_sin;
        state.y += along * mid_sin + left * mid_cos;
        state.heading_rad += yaw_rate * dt_s;
        state.speed_mps = next_speed;
        self.yaw_rate(next_speed, curvature) * rear_m
    }

    pub(super) fn inverse(
        &self,
        prev: &KinState,
        next: &KinState,
        turn_rad: Real,
        dt_s: Real,
        footprint: &Footprint,
    ) -> Action {
        let mean_speed = 0.5 * (prev.speed_mps + next.speed_mps);
        let steering = if mean_speed.abs() < MIN_STEERED_SPEED_MPS {
            0.0
        } else {
            math::atan(turn_rad * self.wheelbase_m(footprint) / (mean_speed * dt_s))
        };
        [(next.speed_mps - prev.speed_mps) / dt_s, steering, 0.0]
    }
}
