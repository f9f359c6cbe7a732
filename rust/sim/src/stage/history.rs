//! The last H states of every agent of a world, for drivers that look back.

use crate::geom::math::is_sound;
use crate::geom::{Point2, Real};
use crate::scene::Scene;
use crate::state::AgentStates;
use serde::{Deserialize, Serialize};

/// Rings of past states, arrays [A, H]; entry 0 of [`History::at`] is the oldest of H steps.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct History {
    num_agents: usize,
    len: usize,
    /// Position of the oldest entry in all rings.
    head: usize,
    position: Vec<Point2>,
    heading_rad: Vec<Real>,
    speed_mps: Vec<Real>,
    valid: Vec<bool>,
}

/// One past state of one agent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PastState {
    /// Centre, scene frame, metres.
    pub position: Point2,
    /// Heading, radians.
    pub heading_rad: Real,
    /// Speed along the heading, m/s.
    pub speed_mps: Real,
    /// Whether the agent was there.
    pub valid: bool,
}

impl History {
    /// Ring of `len` steps that ends at step `step_idx` of the log.
    pub fn from_log(scene: &Scene, step_idx: usize, len: usize) -> Self {
        let num_agents = scene.num_agents();
        let n = num_agents * len;
        let mut history = Self {
            num_agents,
            len,
            head: 0,
            position: vec![Point2::origin(); n],
            heading_rad: vec![0.0; n],
            speed_mps: vec![0.0; n],
            valid: vec![false; n],
        };
        for k in 0..len {
            let Some(t) = (step_idx + k + 1).checked_sub(len) else { continue };
            for a in (0..num_agents).filter(|a| scene.is_valid(*a, t)) {
                let (pose, v, to) = (scene.pose(a, t), scene.tracks.velocity[scene.at(a, t)], a * len + k);
                history.position[to] = pose.position;
                history.heading_rad[to] = pose.heading_rad;
                history.speed_mps[to] = v.x * pose.cos + v.y * pose.sin;
                history.valid[to] = true;
            }
        }
        history
    }

    /// Number of steps H, the present one included.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether the ring holds no step.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Whether the arrays have the lengths that a number of agents asks for, and hold numbers.
    pub(crate) fn fits(&self, num_agents: usize) -> bool {
        let n = num_agents.saturating_mul(self.len);
        let reals = self.position.iter().flat_map(|p| [p.x, p.y]);
        let reals = reals.chain(self.heading_rad.iter().copied()).chain(self.speed_mps.iter().copied());
        self.num_agents == num_agents
            && self.head < self.len
            && reals.into_iter().all(is_sound)
            && [self.position.len(), self.heading_rad.len(), self.speed_mps.len(), self.valid.len()] == [n; 4]
    }

    /// Forgets the oldest step and adds the present one.
    pub fn push(&mut self, states: &AgentStates) {
        for a in 0..self.num_agents {
            let to = a * self.len + self.head;
            self.position[to] = states.position(a);
            self.heading_rad[to] = states.heading_rad[a];
            self.speed_mps[to] = states.speed_mps[a];
            self.valid[to] = states.active[a];
        }
        self.head = (self.head + 1) % self.len;
    }

    /// State of an agent at entry k, 0 the oldest, `len() - 1` the present.
    #[inline]
    pub fn at(&self, agent_idx: usize, k: usize) -> PastState {
        let at = agent_idx * self.len + (self.head + k) % self.len;
        PastState {
            position: self.position[at],
            heading_rad: self.heading_rad[at],
            speed_mps: self.speed_mps[at],
            valid: self.valid[at],
        }
    }
}
