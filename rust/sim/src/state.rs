//! States of the agents of one running world, structure of arrays, and their footprints.

use crate::geom::{OrientedBox, Point2, Pose2, Real, Vector2, math};
use crate::scene::LEVEL_M;
use serde::{Deserialize, Serialize};

/// Size of an agent, constant over an episode.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Footprint {
    /// Half the length, metres.
    pub half_length_m: Real,
    /// Half the width, metres.
    pub half_width_m: Real,
    /// Radius of the circle round the box, metres.
    pub radius_m: Real,
}

impl Footprint {
    /// Footprint from full length and width, metres.
    pub fn new(length_m: Real, width_m: Real) -> Self {
        let (half_length_m, half_width_m) = (0.5 * length_m, 0.5 * width_m);
        Self { half_length_m, half_width_m, radius_m: math::hypot(half_length_m, half_width_m) }
    }

    /// Box of the body at a pose.
    #[inline]
    pub fn at(&self, pose: &Pose2) -> OrientedBox {
        OrientedBox {
            centre: pose.position,
            cos: pose.cos,
            sin: pose.sin,
            half_length_m: self.half_length_m,
            half_width_m: self.half_width_m,
        }
    }
}

/// How high an agent is.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Height {
    /// Elevation of the ground below it, metres.
    pub elevation_m: Real,
    /// Slope of its road along its heading, metres up per metre ahead.
    pub grade: Real,
}

impl Height {
    /// Elevation of its road where that goes on straight, at a place seen from an agent's pose.
    fn at(&self, from: &Pose2, place: Point2) -> Real {
        let d = place - from.position;
        self.elevation_m + self.grade * (d.x * from.cos + d.y * from.sin)
    }
}

/// States of A agents at one step. All arrays have length A. Entries of agents that are not `active` are stale.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct AgentStates {
    /// Centre x in the scene frame, metres.
    pub x: Vec<Real>,
    /// Centre y, metres.
    pub y: Vec<Real>,
    /// Heading, radians, not wrapped.
    pub heading_rad: Vec<Real>,
    /// Cosine of the heading.
    pub cos: Vec<Real>,
    /// Sine of the heading.
    pub sin: Vec<Real>,
    /// Speed along the heading, metres per second; negative when reversing.
    pub speed_mps: Vec<Real>,
    /// Velocity x in the scene frame, metres per second.
    pub velocity_x_mps: Vec<Real>,
    /// Velocity y, metres per second.
    pub velocity_y_mps: Vec<Real>,
    /// Change of speed over the last step, metres per second squared.
    pub acceleration_mps2: Vec<Real>,
    /// Change of heading over the last step, radians per second.
    pub yaw_rate_radps: Vec<Real>,
    /// Whether the agent is in the world.
    pub active: Vec<bool>,
    /// How high each agent is, where the scene has levels; else empty.
    #[serde(skip)]
    pub heights: Vec<Height>,
    /// The chain of hitched vehicles that the agent belongs to; empty where no vehicles are hitched.
    pub(crate) chain: Vec<u32>,
}

impl AgentStates {
    /// States of `num_agents` agents, none of them active.
    pub fn new(num_agents: usize) -> Self {
        let mut states = Self::default();
        states.clear_for(num_agents);
        states
    }

    /// Makes this the states of `num_agents` agents, none of them active, in the same memory.
    pub(crate) fn clear_for(&mut self, num_agents: usize) {
        for column in self.columns_mut() {
            column.clear();
            column.resize(num_agents, 0.0);
        }
        self.cos.fill(1.0);
        self.active.clear();
        self.active.resize(num_agents, false);
        self.heights.clear();
        self.chain.clear();
    }

    /// All numbers of the agents, in the order of the fields.
    pub(crate) fn columns_mut(&mut self) -> [&mut Vec<Real>; 10] {
        [
            &mut self.x,
            &mut self.y,
            &mut self.heading_rad,
            &mut self.cos,
            &mut self.sin,
            &mut self.speed_mps,
            &mut self.velocity_x_mps,
            &mut self.velocity_y_mps,
            &mut self.acceleration_mps2,
            &mut self.yaw_rate_radps,
        ]
    }

    /// Elevation of an agent, metres, in a scene with levels.
    #[inline]
    pub fn elevation_m(&self, agent_idx: usize) -> Option<Real> {
        self.heights.get(agent_idx).map(|height| height.elevation_m)
    }

    /// Whether two agents are on the same level; always in a flat scene.
    ///
    /// They are where their elevations differ by at most [`LEVEL_M`], or where that holds for the road of either,
    /// extended straight to the other's place: a vehicle far ahead up a ramp is on the same road.
    #[inline]
    pub fn same_level(&self, i: usize, j: usize) -> bool {
        self.heights.is_empty() || self.are_level(i, j)
    }

    /// Which pairs of some agents are on different levels, [M, M]; empty in a flat scene.
    pub fn apart(&self, agents: &[usize]) -> Vec<bool> {
        let with = |i: usize| agents.iter().map(move |j| !self.same_level(i, *j));
        if self.heights.is_empty() { Vec::new() } else { agents.iter().flat_map(|i| with(*i)).collect() }
    }

    fn are_level(&self, i: usize, j: usize) -> bool {
        let ([a, b], [p, q]) = ([i, j].map(|k| self.heights[k]), [i, j].map(|k| self.pose(k)));
        let near = |x: Real, y: Real| (x - y).abs() <= LEVEL_M;
        near(a.elevation_m, b.elevation_m)
            || near(a.at(&p, q.position), b.elevation_m)
            || near(b.at(&q, p.position), a.elevation_m)
    }

    /// Whether two agents are hitched to each other: they never touch.
    #[inline]
    pub fn hitched(&self, i: usize, j: usize) -> bool {
        !self.chain.is_empty() && self.chain[i] == self.chain[j]
    }

    /// Number of agents A.
    #[inline]
    pub fn len(&self) -> usize {
        self.x.len()
    }

    /// Whether there is no agent.
    pub fn is_empty(&self) -> bool {
        self.x.is_empty()
    }

    /// Centre of an agent.
    #[inline]
    pub fn position(&self, agent_idx: usize) -> Point2 {
        Point2::new(self.x[agent_idx], self.y[agent_idx])
    }

    /// Velocity of an agent in the scene frame.
    #[inline]
    pub fn velocity(&self, agent_idx: usize) -> Vector2 {
        Vector2::new(self.velocity_x_mps[agent_idx], self.velocity_y_mps[agent_idx])
    }

    /// Pose of an agent, without computing a sine.
    #[inline]
    pub fn pose(&self, agent_idx: usize) -> Pose2 {
        Pose2 {
            position: self.position(agent_idx),
            heading_rad: self.heading_rad[agent_idx],
            cos: self.cos[agent_idx],
            sin: self.sin[agent_idx],
        }
    }

    /// Box of an agent.
    #[inline]
    pub fn oriented_box(&self, agent_idx: usize, footprint: &Footprint) -> OrientedBox {
        footprint.at(&self.pose(agent_idx))
    }

    /// Puts an agent at a pose with a velocity of the scene frame; acceleration and yaw rate become zero.
    pub fn set_pose(&mut self, agent_idx: usize, pose: Pose2, velocity: Vector2) {
        self.x[agent_idx] = pose.position.x;
        self.y[agent_idx] = pose.position.y;
        self.heading_rad[agent_idx] = pose.heading_rad;
        self.cos[agent_idx] = pose.cos;
        self.sin[agent_idx] = pose.sin;
        self.velocity_x_mps[agent_idx] = velocity.x;
        self.velocity_y_mps[agent_idx] = velocity.y;
        self.speed_mps[agent_idx] = velocity.x * pose.cos + velocity.y * pose.sin;
        self.acceleration_mps2[agent_idx] = 0.0;
        self.yaw_rate_radps[agent_idx] = 0.0;
    }
}
