//! The unicycle and its adjoint in plain numbers: the same plan rollout as [`crate::inputs::unicycle::rollout`], in the scene
//! frame, with the gradient of a loss on states with respect to actions.
//!
//! Forward, from (x₀, y₀, ψ₀, v₀), with a and ω clipped as in reference.md#unicycle:
//! v_t = clip(v₀ + Σ_{s≤t} a_s dt), ψ_t = ψ₀ + Σ_{s≤t} ω_s dt, p_t = p_{t-1} + ½ (v_{t-1} + v_t) dt (cos ψ_{t-1}, sin ψ_{t-1}).
//! Backward, sums over time turn round: each clip passes a gradient where it did not act; the yaw-rate bound has none.

use super::context::GuidanceContext;
use crate::inputs::unicycle::plan_limits;
use ccdiff_sim::geom::math;

const ACCELERATION_FREE: u8 = 1;
const SPEED_FREE: u8 = 2;
const YAW_RATE_FREE: u8 = 4;

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
    /// Which clips did not act.
    free: Vec<u8>,
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
            free: vec![0; num_agents * num_steps],
        }
    }

    /// Rolls one agent's actions [T, 2] (m/s², rad/s) out.
    pub fn roll(&mut self, context: &GuidanceContext<'_>, agent: usize, actions: &[f32]) {
        let (pose, start_mps, dt) = (context.poses[agent], context.speed_mps[agent], context.dt_s);
        let (mut x, mut y) = (pose.position.x, pose.position.y);
        let limits = plan_limits();
        let (mut sin, mut cos) = (pose.sin, pose.cos);
        let (mut before, mut gained, mut turned) = (start_mps, 0.0f32, 0.0f32);
        let first = agent * self.num_steps;
        for (at, action) in (first..first + self.num_steps).zip(actions.chunks_exact(2)) {
            let acceleration = action[0].clamp(limits.acceleration_mps2[0], limits.acceleration_mps2[1]);
            gained += acceleration * dt;
            let wanted = gained + start_mps;
            let after = wanted.clamp(limits.speed_mps[0], limits.speed_mps[1]);
            let bound = limits.yaw_rate_bound(before);
            let yaw_rate = action[1].clamp(-bound, bound);
            let step_m = (before + after) * (0.5 * dt);
            x += step_m * cos;
            y += step_m * sin;
            turned += yaw_rate * dt;
            (sin, cos) = math::sin_cos(pose.heading_rad + turned);
            (self.x_m[at], self.y_m[at], self.speed_mps[at]) = (x, y, after);
            (self.cos[at], self.sin[at]) = (cos, sin);
            let free = |acted: bool, bit: u8| if acted { 0 } else { bit };
            self.free[at] = free(acceleration != action[0], ACCELERATION_FREE)
                | free(after != wanted, SPEED_FREE)
                | free(yaw_rate != action[1], YAW_RATE_FREE);
            before = after;
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
            let free = |bit: u8| f32::from(u8::from(self.free[at] & bit != 0));
            to_gained += to_speed * free(SPEED_FREE);
            to_turned += of_states.heading[at];
            out[2 * t] = dt * to_gained * free(ACCELERATION_FREE);
            out[2 * t + 1] = dt * to_turned * free(YAW_RATE_FREE);
            // the heading before step t is the one after step t - 1
            to_turned += step_m * (to_y * cos - to_x * sin);
        }
    }
}
