//! Delta pose: the agent is put where the action says.

use super::{Action, KinState, Motion, is_range};
use crate::geom::{Real, math};
use serde::{Deserialize, Serialize};

/// Limits of one step of the delta-pose model, in the agent's own frame.
///
/// The defaults allow −10 to 40 m/s along, 10 m/s across and 5 rad/s at steps of 0.1 s.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DeltaPoseLimits {
    /// Least and most way forward per step, metres.
    pub dx_m: [Real; 2],
    /// Least and most way to the left per step, metres.
    pub dy_m: [Real; 2],
    /// Least and most turn to the left per step, radians.
    pub dheading_rad: [Real; 2],
}

impl Default for DeltaPoseLimits {
    fn default() -> Self {
        Self { dx_m: [-1.0, 4.0], dy_m: [-1.0, 1.0], dheading_rad: [-0.5, 0.5] }
    }
}

impl DeltaPoseLimits {
    pub(super) fn action_bounds(&self) -> (Action, Action) {
        let columns = [self.dx_m, self.dy_m, self.dheading_rad];
        (columns.map(|c| c[0]), columns.map(|c| c[1]))
    }

    pub(super) fn first_fault(&self) -> Option<&'static str> {
        [
            ("dx_m", is_range(self.dx_m)),
            ("dy_m", is_range(self.dy_m)),
            ("dheading_rad", is_range(self.dheading_rad)),
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
        let dx = action[0].clamp(self.dx_m[0], self.dx_m[1]);
        let dy = action[1].clamp(self.dy_m[0], self.dy_m[1]);
        let turn_rad = action[2].clamp(self.dheading_rad[0], self.dheading_rad[1]);
        state.x += cos * dx - sin * dy;
        state.y += sin * dx + cos * dy;
        state.heading_rad += turn_rad;
        // the mean velocity of the step, seen along the new heading
        let (turn_sin, turn_cos) = math::sin_cos(turn_rad);
        state.speed_mps = (turn_cos * dx + turn_sin * dy) / dt_s;
        Motion { lateral_mps: (turn_cos * dy - turn_sin * dx) / dt_s }
    }
}
