//! Progress along the route, and when the goal is reached: the one account that rewards, info, metrics, observations and
//! success are made from.

use crate::geom::{Point2, Real};
use crate::stage::PreparedScene;
use crate::state::AgentStates;
use serde::{Deserialize, Serialize};

/// Distances to a goal below this are a log that stands still, metres.
const STATIONARY_M: Real = 2.0;
/// Progress counts up to this distance from the route, metres: half a road of four lanes of 3.5 m.
const CORRIDOR_M: Real = 7.0;
/// The goal is reached at this distance from the logged place, metres: as in MetaDrive (`_is_arrive_destination`).
const GOAL_M: Real = 5.0;
/// A log slower than the first at the goal stands there; that goal is reached at most at the second, m/s.
const STANDING_MPS: Real = 0.5;
const SLOW_MPS: Real = 1.5;

/// How far an agent has come on its way to the goal.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct Progress {
    /// Positions along the route: where the episode began, the goal, and the farthest one that counts.
    start_s_m: Real,
    goal_s_m: Real,
    best_s_m: Real,
    /// The logged place at the end of the episode.
    pub(crate) goal: Point2,
    /// Whether the log stands there.
    stops: bool,
    pub(crate) reached: bool,
}

impl Progress {
    /// The way of an agent from where it is logged at a step to where it is logged last up to another one.
    pub(crate) fn new(scene: &PreparedScene, agent_idx: usize, start_step: usize, end_step: usize) -> Self {
        let last = end_step.min(scene.scene.num_steps - 1);
        let last = (start_step..=last).rev().find(|t| scene.scene.is_valid(agent_idx, *t));
        let last = last.unwrap_or(start_step);
        let start_s_m = scene.logged_s_m(agent_idx, start_step);
        let (goal, speed_mps) = scene
            .log
            .at(agent_idx, last)
            .map_or((Point2::origin(), 0.0), |(pose, velocity)| (pose.position, velocity.norm()));
        Self {
            start_s_m,
            goal_s_m: scene.logged_s_m(agent_idx, last).max(start_s_m),
            best_s_m: start_s_m,
            goal,
            stops: speed_mps < STANDING_MPS,
            reached: false,
        }
    }

    /// Takes account of a step and returns the new progress, metres; the last metres count when the goal is reached.
    pub(crate) fn advance(
        &mut self,
        states: &AgentStates,
        agent_idx: usize,
        s_m: Real,
        from_route_m: Real,
        dt_s: Real,
    ) -> Real {
        let (position, moved) = (states.position(agent_idx), states.velocity(agent_idx) * dt_s);
        let before_m = self.best_s_m;
        // routes may pass by the goal before they end there
        let on_branch = (s_m - self.goal_s_m).abs() <= 2.0 * GOAL_M + moved.norm();
        if on_branch && !self.reached && !self.stands() {
            // the nearest point of the way of this step
            let back = (position - self.goal).dot(&moved) / moved.norm_squared().max(1e-9);
            let nearest_m = (position - moved * back.clamp(0.0, 1.0) - self.goal).norm();
            let slow = states.speed_mps[agent_idx].abs() <= SLOW_MPS;
            self.reached = nearest_m <= self.radius_m() && (slow || !self.stops);
        }
        if self.reached {
            self.best_s_m = self.goal_s_m;
        } else if from_route_m <= CORRIDOR_M {
            self.best_s_m = before_m.max(s_m.min(self.goal_s_m - self.radius_m()));
        }
        self.best_s_m - before_m
    }

    /// Distance at which the goal is reached, metres: a quarter of the way where that is short.
    fn radius_m(&self) -> Real {
        GOAL_M.min(0.25 * (self.goal_s_m - self.start_s_m))
    }

    /// Whether the log stays where it is.
    fn stands(&self) -> bool {
        self.goal_s_m - self.start_s_m < STATIONARY_M
    }

    /// Way since the start, metres.
    pub(crate) fn travelled_m(&self) -> Real {
        self.best_s_m - self.start_s_m
    }

    /// Share of the way to the goal, 0 to 1: 1 where the goal is reached, and where the log stands still.
    pub(crate) fn completion(&self) -> Real {
        if self.stands() { 1.0 } else { self.travelled_m() / (self.goal_s_m - self.start_s_m) }
    }

    /// Way that is left along the route, metres.
    pub(crate) fn remaining_m(&self, s_m: Real) -> Real {
        if self.reached { 0.0 } else { (self.goal_s_m - s_m).max(0.0) }
    }

    /// Whether an agent at a place along the route has gone past its goal without reaching it.
    pub(crate) fn has_missed(&self, s_m: Real) -> bool {
        !self.stands() && !self.reached && s_m > self.goal_s_m + GOAL_M
    }

    /// Numbers that must be finite.
    pub(crate) fn reals(&self) -> [Real; 5] {
        [self.start_s_m, self.goal_s_m, self.best_s_m, self.goal.x, self.goal.y]
    }
}
