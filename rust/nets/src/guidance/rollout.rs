//! The unicycle of plans in the scene frame, and the gradient of a loss on states with respect to actions.
//!
//! Forward, from (x₀, y₀, ψ₀, v₀), with a and ω clipped as in reference.md#unicycle:
//! v_t = clip(v₀ + Σ_{s≤t} a_s dt), ψ_t = ψ₀ + Σ_{s≤t} ω_s dt, p_t = p_{t-1} + ½ (v_{t-1} + v_t) dt (cos ψ_{t-1}, sin ψ_{t-1}).
//! Backward, sums over time turn round: each clip passes a gradient where it did not act; the yaw-rate bound has none.

use super::context::GuidanceContext;
use crate::inputs::unicycle::rolled;

/// Rolled-out plans of the M agents of a world, scene frame, row-major [M, T]; entry t is the state after action t.
#[derive(Debug, Clone, PartialEq)]
pub struct Rollout {
    /// Steps T.
    pub num_steps: usize,
    /// Centre x, metres.
    pub x_m: Vec<f32>,
    /// Centre y, metres.
    pub y_m: Vec<f32>,
    /// Speed along the heading, metres per second.
    pub speed_mps: Vec<f32>,
    /// Cosine of the heading.
    pub cos: Vec<f32>,
    /// Sine of the heading.
    pub sin: Vec<f32>,
    /// Whether the clips of acceleration, speed and yaw rate did not act.
    free: Vec<[bool; 3]>,
}

/// Gradient of a loss with respect to the states of a [`Rollout`], row-major [M, T].
#[derive(Debug, Clone, PartialEq)]
pub struct StateGradient {
    /// With respect to x.
    pub x: Vec<f32>,
    /// With respect to y.
    pub y: Vec<f32>,
    /// With respect to the speed.
    pub speed: Vec<f32>,
    /// With respect to the heading.
    pub heading: Vec<f32>,
}

impl StateGradient {
    /// Zero gradient of M agents over T steps.
    pub fn zeros(num_agents: usize, num_steps: usize) -> Self {
        let zeros = || vec![0.0; num_agents * num_steps];
        Self { x: zeros(), y: zeros(), speed: zeros(), heading: zeros() }
    }

    /// Sets everything to zero.
    pub fn clear(&mut self) {
        for part in [&mut self.x, &mut self.y, &mut self.speed, &mut self.heading] {
            part.fill(0.0);
        }
    }
}

impl Rollout {
    /// Room for M agents over T steps.
    pub fn zeros(num_agents: usize, num_steps: usize) -> Self {
        let zeros = || vec![0.0; num_agents * num_steps];
        Self {
            num_steps,
            x_m: zeros(),
            y_m: zeros(),
            speed_mps: zeros(),
            cos: zeros(),
            sin: zeros(),
            free: vec![[false; 3]; num_agents * num_steps],
        }
    }

    /// Rolls one agent's actions [T, 2] (m/s², rad/s) out.
    pub fn roll(&mut self, context: &GuidanceContext<'_>, agent: usize, actions: &[f32]) {
        let moments = rolled(context.poses[agent], context.speed_mps[agent], context.dt_s, actions);
        for (at, m) in (agent * self.num_steps..).zip(moments) {
            (self.x_m[at], self.y_m[at], self.speed_mps[at]) = (m.x_m, m.y_m, m.speed_mps);
            (self.cos[at], self.sin[at], self.free[at]) = (m.cos, m.sin, m.free);
        }
    }

    /// Gradient with respect to one agent's actions [T, 2] of a loss with this gradient with respect to the states.
    pub fn vjp(
        &self,
        context: &GuidanceContext<'_>,
        agent: usize,
        of_states: &StateGradient,
        out: &mut [f32],
    ) {
        let (pose, start_mps, dt) = (context.poses[agent], context.speed_mps[agent], context.dt_s);
        let first = agent * self.num_steps;
        // suffix sums over the steps from t on: of x, y, of the gained speed, of the turned angle
        let (mut to_x, mut to_y, mut to_gained, mut to_turned) = (0.0f32, 0.0f32, 0.0f32, 0.0f32);
        let mut to_next_step_m = 0.0f32;
        for t in (0..self.num_steps).rev() {
            let at = first + t;
            let (before, cos, sin) = if t == 0 {
                (start_mps, pose.cos, pose.sin)
            } else {
                (self.speed_mps[at - 1], self.cos[at - 1], self.sin[at - 1])
            };
            let step_m = (before + self.speed_mps[at]) * (0.5 * dt);
            to_x += of_states.x[at];
            to_y += of_states.y[at];
            let to_step_m = to_x * cos + to_y * sin;
            let to_speed = of_states.speed[at] + 0.5 * dt * (to_step_m + to_next_step_m);
            to_next_step_m = to_step_m;
            let [acceleration, speed, yaw_rate] = self.free[at].map(|free| f32::from(u8::from(free)));
            to_gained += to_speed * speed;
            to_turned += of_states.heading[at];
            out[2 * t] = dt * to_gained * acceleration;
            out[2 * t + 1] = dt * to_turned * yaw_rate;
            // the heading before step t is the one after step t - 1
            to_turned += step_m * (to_y * cos - to_x * sin);
        }
    }
}
