//! How an action moves an agent: unicycle, kinematic bicycle and delta pose, and their inverses.
//!
//! All models share the state (x, y, ψ, v): centre of the box in the scene frame, heading, speed along the heading.
//! One step of length `dt`:
//!
//! - **Unicycle** (method of the released models of traffic), action (a, ω):
//!   a ← clip(a), |ω| ≤ max(ω_min, min(κ_max |v|, a_lat / max(|v|, 0.1))),
//!   v' = clip(v + a dt), ψ' = ψ + ω dt, p' = p + ½ (v + v') (cos ψ, sin ψ) dt.
//! - **Bicycle** (kinematic, Kong et al., IV 2015), action (a, δ):
//!   v' = clip(v + a dt), v̄ = ½ (v + v'), ω = v̄ tan δ / L, |ω| ≤ a_lat / |v̄|, ψ' = ψ + ω dt,
//!   p' = p + dt R(ψ + ½ ω dt) (v̄, ω l_r). The second component is the slip at the centre: tan β = tan δ l_r / L.
//! - **Delta pose**, action (dx, dy, dψ) in the agent's own frame: p' = p + R(ψ) (dx, dy), ψ' = ψ + dψ.
//! - **Assisted**, action (Δa, d): the unicycle with the acceleration of IDM or PDM-Closed plus Δa within a bounded jerk,
//!   steered to the distance d from its way. Worlds make (a, ω) of it, since both see the others; what is here takes (a, ω).
//!
//! Nothing here knows agents' kinds, maps or other agents.

mod action_grid;
mod assisted;
mod bicycle;
mod delta_pose;
mod unicycle;

pub use action_grid::ActionGrid;
pub(crate) use assisted::yaw_rate;
pub use assisted::{AssistedBase, AssistedLimits};
pub use bicycle::BicycleLimits;
pub use delta_pose::DeltaPoseLimits;
pub use unicycle::UnicycleLimits;

use crate::choices;
use crate::error::{Result, SimError};
use crate::geom::{Pose2, Real, Vector2, math};
use crate::state::{AgentStates, Footprint};
use serde::{Deserialize, Serialize};

/// An action; models with two columns ignore the third.
pub type Action = [Real; 3];

/// State of one agent as the models see it.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct KinState {
    /// Centre x in the scene frame, metres.
    pub x: Real,
    /// Centre y, metres.
    pub y: Real,
    /// Heading, radians, not wrapped.
    pub heading_rad: Real,
    /// Speed along the heading, metres per second; negative when reversing.
    pub speed_mps: Real,
}

choices! {
    /// Model of motion with its limits.
    #[derive(Clone, Copy)]
    pub enum Dynamics {
        /// Action (acceleration m/s², yaw rate rad/s).
        Unicycle(UnicycleLimits) = "unicycle",
        /// Action (acceleration m/s², steering angle rad).
        Bicycle(BicycleLimits) = "bicycle",
        /// Action (dx m, dy m, dψ rad) in the agent's own frame.
        DeltaPose(DeltaPoseLimits) = "delta_pose",
        /// Action (change of the base's acceleration m/s², distance from its way m).
        Assisted(AssistedLimits) = "assisted",
    }
}

impl Default for Dynamics {
    fn default() -> Self {
        Self::Unicycle(UnicycleLimits::default())
    }
}

impl Dynamics {
    /// Refuses assisted dynamics, whose steps depend on other agents.
    ///
    /// # Errors
    /// [`SimError::Config`].
    pub fn check_moves_by_itself(&self) -> Result<()> {
        match self {
            Self::Assisted(_) => {
                Err(SimError::config("action.dynamics", "assisted", "a model of motion by itself"))
            }
            _ => Ok(()),
        }
    }

    /// Names of the columns of an action, with units: 2, or 3 for delta pose.
    pub fn columns(&self) -> &'static [&'static str] {
        match self {
            Self::Unicycle(_) => &["acceleration_mps2", "yaw_rate_radps"],
            Self::Bicycle(_) => &["acceleration_mps2", "steering_rad"],
            Self::DeltaPose(_) => &["dx_m", "dy_m", "dheading_rad"],
            Self::Assisted(_) => &["delta_mps2", "offset_m"],
        }
    }

    /// Lowest and highest useful action; the unused third column is (0, 0).
    ///
    /// Actions beyond it are legal and are clipped by [`Self::step`].
    pub fn action_bounds(&self) -> (Action, Action) {
        match self {
            Self::Unicycle(limits) => limits.action_bounds(),
            Self::Bicycle(limits) => limits.action_bounds(),
            Self::DeltaPose(limits) => limits.action_bounds(),
            Self::Assisted(limits) => limits.action_bounds(),
        }
    }

    /// Clips an action to [`Self::action_bounds`].
    pub fn clip(&self, action: Action) -> Action {
        let (low, high) = self.action_bounds();
        std::array::from_fn(|i| action[i].clamp(low[i], high[i]))
    }

    /// Moves a state by one step. The action must be finite; it is clipped to the limits.
    #[inline]
    pub fn step(&self, state: &mut KinState, action: Action, dt_s: Real, footprint: &Footprint) {
        let (sin, cos) = math::sin_cos(state.heading_rad);
        self.advance(state, Vector2::new(cos, sin), action, dt_s, footprint);
    }

    /// Moves one agent of a world by one step and refreshes everything derived: cosine, sine, velocity,
    /// acceleration and yaw rate. The action must be finite; it is clipped to the limits.
    #[inline]
    pub fn step_agent(
        &self,
        states: &mut AgentStates,
        agent_idx: usize,
        action: Action,
        dt_s: Real,
        footprint: &Footprint,
    ) {
        let before = states.kin_state(agent_idx);
        let mut after = before;
        let rates = [states.acceleration_mps2[agent_idx], states.yaw_rate_radps[agent_idx]];
        let action = match self {
            Self::Unicycle(limits) => limits.within_reach(action, rates, dt_s),
            _ => action,
        };
        let heading = Vector2::new(states.cos[agent_idx], states.sin[agent_idx]);
        let lateral_mps = self.advance(&mut after, heading, action, dt_s, footprint);
        let pose = Pose2::new(after.x, after.y, after.heading_rad);
        states.set_pose(agent_idx, pose, pose.rotate(Vector2::new(after.speed_mps, lateral_mps)));
        // `place` rounds the speed through the rotation
        states.speed_mps[agent_idx] = after.speed_mps;
        states.acceleration_mps2[agent_idx] = (after.speed_mps - before.speed_mps) / dt_s;
        states.yaw_rate_radps[agent_idx] = (after.heading_rad - before.heading_rad) / dt_s;
    }

    /// As [`Self::step`], with the direction of the heading; returns the speed to the left of the new one, m/s.
    #[inline]
    fn advance(
        &self,
        state: &mut KinState,
        heading: Vector2,
        action: Action,
        dt_s: Real,
        footprint: &Footprint,
    ) -> Real {
        match self {
            Self::Unicycle(limits) => limits.advance(state, heading, action, dt_s),
            Self::Bicycle(limits) => limits.advance(state, heading, action, dt_s, footprint),
            Self::DeltaPose(limits) => limits.advance(state, heading, action, dt_s),
            Self::Assisted(limits) => limits.unicycle().advance(state, heading, action, dt_s),
        }
    }

    /// The action that leads from one state to the next, not clipped: feed it to [`Self::clip`] for expert actions.
    ///
    /// Exact for pairs that a step within the limits made. On logs the unicycle and the bicycle use the change of
    /// speed and heading and leave the positions out, as tbsim and its heirs do (sideways motion has no action).
    pub fn inverse(&self, prev: &KinState, next: &KinState, dt_s: Real, footprint: &Footprint) -> Action {
        let turn_rad = math::wrap_angle(next.heading_rad - prev.heading_rad);
        match self {
            Self::Unicycle(_) | Self::Assisted(_) => {
                [(next.speed_mps - prev.speed_mps) / dt_s, turn_rad / dt_s, 0.0]
            }
            Self::Bicycle(limits) => limits.inverse(prev, next, turn_rad, dt_s, footprint),
            Self::DeltaPose(_) => {
                let (sin, cos) = math::sin_cos(prev.heading_rad);
                let (dx, dy) = (next.x - prev.x, next.y - prev.y);
                [cos * dx + sin * dy, cos * dy - sin * dx, turn_rad]
            }
        }
    }
}

impl AgentStates {
    /// State of an agent as the motion models see it.
    #[inline]
    pub fn kin_state(&self, agent_idx: usize) -> KinState {
        KinState {
            x: self.x[agent_idx],
            y: self.y[agent_idx],
            heading_rad: self.heading_rad[agent_idx],
            speed_mps: self.speed_mps[agent_idx],
        }
    }
}
