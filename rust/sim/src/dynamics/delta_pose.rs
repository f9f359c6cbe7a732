//! Delta pose: the agent is put where the action says.

use super::{Action, KinState};
use crate::geom::{Real, Vector2, math};
use crate::options;
use crate::options::{MOTION, within};

options! {
    /// Limits of one step of the delta-pose model: actions are dx, dy (m) and turn (rad) in the agent's own frame.
    ///
    /// The defaults allow −10 to 40 m/s along, 10 m/s across and 5 rad/s at steps of 0.1 s.
    #[derive(Clone, Copy)]
    #[serde(deny_unknown_fields, default)]
    pub struct DeltaPoseLimits {
        /// Lowest and highest displacement forwards per step.
        dx_m: [Real; 2] = [-1.0, 4.0], unit "m", range MOTION;
        /// Lowest and highest displacement to the left per step.
        dy_m: [Real; 2] = [-1.0, 1.0], unit "m", range MOTION;
        /// Lowest and highest turn to the left per step.
        dheading_rad: [Real; 2] = [-0.5, 0.5], unit "rad", range within(-3.1, 3.1);
    }
}

impl DeltaPoseLimits {
    pub(super) fn action_bounds(&self) -> (Action, Action) {
        let columns = [self.dx_m, self.dy_m, self.dheading_rad];
        (columns.map(|c| c[0]), columns.map(|c| c[1]))
    }

    #[inline]
    pub(super) fn advance(&self, state: &mut KinState, heading: Vector2, action: Action, dt_s: Real) -> Real {
        let dx = action[0].clamp(self.dx_m[0], self.dx_m[1]);
        let dy = action[1].clamp(self.dy_m[0], self.dy_m[1]);
        let turn_rad = action[2].clamp(self.dheading_rad[0], self.dheading_rad[1]);
        state.x += heading.x * dx - heading.y * dy;
        state.y += heading.y * dx + heading.x * dy;
        state.heading_rad += turn_rad;
        // the mean velocity of the step, seen along the new heading
        let (turn_sin, turn_cos) = math::sin_cos(turn_rad);
        state.speed_mps = (turn_cos * dx + turn_sin * dy) / dt_s;
        (turn_cos * dy - turn_sin * dx) / dt_s
    }
}
