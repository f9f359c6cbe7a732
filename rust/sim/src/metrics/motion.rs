//! A view of one recorded scene.

use crate::error::{Result, SimError, check_length};
use crate::geom::{Point2, Pose2, Real, Vector2};
use crate::state::{AgentStates, Footprint, Height};

/// Slopes are told of steps of this length at least, metres, and are at most so steep.
const LEAST_WAY_M: Real = 0.2;
const STEEPEST: Real = 0.3;

/// States of A agents over T steps, row-major [A, T]: agent a at step t is entry `a * T + t`.
///
/// Entries where `valid` is false mean nothing and may hold any number.
#[derive(Debug, Clone, Copy)]
pub struct Trajectories<'a> {
    num_steps: usize,
    dt_s: Real,
    x_m: &'a [Real],
    y_m: &'a [Real],
    heading_rad: &'a [Real],
    valid: &'a [bool],
    footprints: &'a [Footprint],
    elevation_m: &'a [Real],
}

impl<'a> Trajectories<'a> {
    /// A view of A * T states, with A footprints.
    ///
    /// # Errors
    /// [`SimError::Length`] where the arrays do not agree, [`SimError::Config`] for a time step that is not positive
    /// or a valid state that is not finite.
    pub fn new(
        dt_s: Real,
        x_m: &'a [Real],
        y_m: &'a [Real],
        heading_rad: &'a [Real],
        valid: &'a [bool],
        footprints: &'a [Footprint],
    ) -> Result<Self> {
        let expected = x_m.len();
        for (what, got) in [("y", y_m.len()), ("heading", heading_rad.len()), ("validity", valid.len())] {
            check_length(what, got, expected)?;
        }
        let num_steps = expected.checked_div(footprints.len()).unwrap_or(0);
        check_length("x", expected, num_steps * footprints.len())?;
        if !(dt_s.is_finite() && dt_s > 0.0) {
            return Err(SimError::config("dt_s", dt_s, "a positive number of seconds"));
        }
        let finite = |k: usize| x_m[k].is_finite() && y_m[k].is_finite() && heading_rad[k].is_finite();
        if let Some(k) = (0..expected).find(|&k| valid[k] && !finite(k)) {
            let got =
                format!("a state that is not finite at agent {}, step {}", k / num_steps, k % num_steps);
            return Err(SimError::config("motion", got, "finite states wherever an agent is valid"));
        }
        Ok(Self { num_steps, dt_s, x_m, y_m, heading_rad, valid, footprints, elevation_m: &[] })
    }

    /// The same with the elevations of the ground below the agents [A * T], metres: who is on another level is out of
    /// reach. None, where there are none.
    ///
    /// # Errors
    /// [`SimError::Length`] where their number differs, [`SimError::Config`] for one of a valid state that is not finite.
    pub fn with_elevations(self, elevation_m: &'a [Real]) -> Result<Self> {
        if elevation_m.is_empty() {
            return Ok(self);
        }
        check_length("elevations", elevation_m.len(), self.valid.len())?;
        let states = elevation_m.iter().zip(self.valid);
        if let Some((z, _)) = states.into_iter().find(|(z, valid)| **valid && !z.is_finite()) {
            return Err(SimError::config("elevation_m", z, "finite numbers wherever an agent is valid"));
        }
        Ok(Self { elevation_m, ..self })
    }

    /// How high an agent is, where elevations are known. Indices must be in range.
    pub(super) fn height(&self, agent_idx: usize, step_idx: usize) -> Option<Height> {
        let elevation_m = *self.elevation_m.get(agent_idx * self.num_steps + step_idx)?;
        let rise_m = self.steps_of_velocity(agent_idx, step_idx).map(|(from, to)| {
            let [from, to] = [from, to].map(|t| self.elevation_m[agent_idx * self.num_steps + t]);
            to - from
        });
        let pose = self.pose(agent_idx, step_idx);
        let way = self.velocity(agent_idx, step_idx) * self.dt_s;
        let ahead_m = way.x * pose.cos + way.y * pose.sin;
        let grade = if ahead_m.abs() < LEAST_WAY_M { 0.0 } else { rise_m.unwrap_or(0.0) / ahead_m };
        Some(Height { elevation_m, grade: grade.clamp(-STEEPEST, STEEPEST) })
    }

    /// Number of agents A.
    pub fn num_agents(&self) -> usize {
        self.footprints.len()
    }

    /// Number of steps T.
    pub fn num_steps(&self) -> usize {
        self.num_steps
    }

    /// Time between steps, seconds.
    pub fn dt_s(&self) -> Real {
        self.dt_s
    }

    /// Footprints of the agents.
    pub fn footprints(&self) -> &'a [Footprint] {
        self.footprints
    }

    /// Whether an agent is there at a step; false out of range.
    pub fn is_valid(&self, agent_idx: usize, step_idx: usize) -> bool {
        step_idx < self.num_steps
            && self.valid.get(agent_idx * self.num_steps + step_idx).copied().unwrap_or(false)
    }

    /// Centre of an agent, metres. Indices must be in range.
    pub(super) fn position(&self, agent_idx: usize, step_idx: usize) -> Point2 {
        let k = agent_idx * self.num_steps + step_idx;
        Point2::new(self.x_m[k], self.y_m[k])
    }

    /// Heading of an agent, radians. Indices must be in range.
    pub(super) fn heading_rad(&self, agent_idx: usize, step_idx: usize) -> Real {
        self.heading_rad[agent_idx * self.num_steps + step_idx]
    }

    pub(super) fn pose(&self, agent_idx: usize, step_idx: usize) -> Pose2 {
        let p = self.position(agent_idx, step_idx);
        Pose2::new(p.x, p.y, self.heading_rad(agent_idx, step_idx))
    }

    /// Velocity from the step before, or to the step after where the agent was absent before; zero where both are
    /// missing. Indices must be in range.
    pub(super) fn velocity(&self, agent_idx: usize, step_idx: usize) -> Vector2 {
        let Some((from, to)) = self.steps_of_velocity(agent_idx, step_idx) else { return Vector2::zeros() };
        (self.position(agent_idx, to) - self.position(agent_idx, from)) / self.dt_s
    }

    fn steps_of_velocity(&self, agent_idx: usize, step_idx: usize) -> Option<(usize, usize)> {
        if step_idx > 0 && self.is_valid(agent_idx, step_idx - 1) {
            Some((step_idx - 1, step_idx))
        } else {
            self.is_valid(agent_idx, step_idx + 1).then_some((step_idx, step_idx + 1))
        }
    }

    /// Writes the states of all agents at a step. `step_idx` must be in range.
    pub(super) fn states_at(&self, step_idx: usize, out: &mut AgentStates) {
        if out.len() != self.num_agents() {
            *out = AgentStates::new(self.num_agents());
        }
        if !self.elevation_m.is_empty() {
            out.heights.resize(self.num_agents(), Height::default());
        }
        for agent in 0..self.num_agents() {
            out.active[agent] = self.is_valid(agent, step_idx);
            if out.active[agent] {
                out.set_pose(agent, self.pose(agent, step_idx), self.velocity(agent, step_idx));
                if let Some(height) = self.height(agent, step_idx) {
                    out.heights[agent] = height;
                }
            }
        }
    }
}
