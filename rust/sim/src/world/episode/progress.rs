//! Progress along the route, and when the goal is reached: the one account that rewards, info, metrics, observations and
//! success are made from.

use crate::geom::{Point2, Real};
use crate::stage::PreparedScene;
use crate::state::AgentStates;
use serde::{Deserialize, Serialize};

/// Goals nearer than this, along the route and in the plane, are those of a log that stands still, metres.
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
    /// Positions along the route: where the episode began, the goal (the start, where it is not ahead on the route), and
    /// the farthest one that counts.
    start_s_m: Real,
    goal_s_m: Real,
    best_s_m: Real,
    /// The logged place at the end of the episode.
    pub(crate) goal: Point2,
    /// Distance from it in the plane: at the start, and now.
    apart_m: Real,
    left_m: Real,
    /// Whether the log stands there, and else its speed, m/s.
    stops: bool,
    goal_speed_mps: Real,
    /// Whether the agent is there now, and whether that has been its arrival.
    is_there: bool,
    pub(crate) reached: bool,
}

impl Progress {
    /// The way of an agent from where it is logged at a step to where it is logged last up to another one.
    pub(crate) fn new(scene: &PreparedScene, agent_idx: usize, start_step: usize, end_step: usize) -> Self {
        let last = end_step.min(scene.scene.num_steps - 1);
        let last = (start_step..=last).rev().find(|t| scene.scene.is_valid(agent_idx, *t));
        let last = last.unwrap_or(start_step);
        let at = |t| scene.log.at(agent_idx, t).map(|(pose, velocity)| (pose.position, velocity.norm()));
        let (goal, speed_mps) = at(last).unwrap_or((Point2::origin(), 0.0));
        let apart_m = at(start_step).map_or(0.0, |(start, _)| (goal - start).norm());
        let start_s_m = scene.logged_s_m(agent_idx, start_step);
        let mut made = Self {
            start_s_m,
            goal_s_m: scene.logged_s_m(agent_idx, last),
            best_s_m: start_s_m,
            goal,
            apart_m,
            left_m: apart_m,
            stops: speed_mps < STANDING_MPS,
            goal_speed_mps: if speed_mps < STANDING_MPS { 0.0 } else { speed_mps },
            is_there: false,
            reached: false,
        };
        let on_route = scene.routes[agent_idx].path.at(made.goal_s_m).position;
        if !made.is_ahead() || (on_route - goal).norm() > made.radius_m() {
            made.goal_s_m = start_s_m;
        }
        made.is_there = made.stands();
        made
    }

    /// Takes account of a step and returns the new progress, metres; the last metres count when the goal is reached.
    ///
    /// Where the log stands, the goal is reached by who is there in the last step of the episode.
    pub(crate) fn advance(
        &mut self,
        states: &AgentStates,
        agent_idx: usize,
        s_m: Real,
        from_route_m: Real,
        dt_s: Real,
        is_last: bool,
    ) -> Real {
        let (position, moved) = (states.position(agent_idx), states.velocity(agent_idx) * dt_s);
        let before_m = self.best_s_m;
        self.left_m = (position - self.goal).norm();
        // routes may pass by the goal before they end there
        let on_branch = !self.is_ahead() || (s_m - self.goal_s_m).abs() <= 2.0 * GOAL_M + moved.norm();
        // the nearest point of the way of this step; who is to stay is looked at where the step ends
        let back = if self.stands() { 0.0 } else { (position - self.goal).dot(&moved) };
        let back = (back / moved.norm_squared().max(1e-9)).clamp(0.0, 1.0);
        let nearest_m = (position - moved * back - self.goal).norm();
        let slow = states.speed_mps[agent_idx].abs() <= SLOW_MPS;
        self.is_there = on_branch && nearest_m <= self.radius_m() && (slow || !self.stops);
        self.reached |= self.is_there && (is_last || !self.stands());
        if self.reached {
            self.best_s_m = self.goal_s_m;
        } else if self.is_ahead() && from_route_m <= CORRIDOR_M {
            self.best_s_m = before_m.max(s_m.min(self.goal_s_m - self.radius_m()));
        }
        self.best_s_m - before_m
    }

    /// Whether the goal is ahead on the route, where a way along it counts; else the plane alone does.
    fn is_ahead(&self) -> bool {
        self.goal_s_m - self.start_s_m >= STATIONARY_M
    }

    /// Whether the log stays where it is.
    fn stands(&self) -> bool {
        !self.is_ahead() && self.apart_m < STATIONARY_M
    }

    /// Distance at which the goal is reached, metres: a quarter of the way where that is short.
    fn radius_m(&self) -> Real {
        let way_m = if self.is_ahead() { self.goal_s_m - self.start_s_m } else { self.apart_m };
        if self.stands() { GOAL_M } else { GOAL_M.min(0.25 * way_m) }
    }

    /// Way since the start, metres.
    pub(crate) fn travelled_m(&self) -> Real {
        self.best_s_m - self.start_s_m
    }

    /// Share of the way to the goal, 0 to 1: 1 from the arrival on and, where the log stands, at its place. Where the goal
    /// is not ahead on the route, it is a share of the distance in the plane.
    pub(crate) fn completion(&self) -> Real {
        if self.reached || self.is_there && self.stands() {
            1.0
        } else if self.is_ahead() {
            self.travelled_m() / (self.goal_s_m - self.start_s_m)
        } else {
            let radius_m = self.radius_m();
            (1.0 - self.left_m.max(radius_m) / self.apart_m.max(2.0 * radius_m)).max(0.0)
        }
    }

    /// Way to the goal along the route, metres, negative past it; in the plane where the log moves to one that is not ahead; 0
    /// once it is reached.
    pub(crate) fn ahead_m(&self, s_m: Real) -> Real {
        match (self.reached, self.is_ahead() || self.stands()) {
            (true, _) => 0.0,
            (false, true) => self.goal_s_m - s_m,
            (false, false) => self.left_m,
        }
    }

    /// Way that is left, metres: along the route, or in the plane where the goal is not ahead on it.
    pub(crate) fn remaining_m(&self, s_m: Real) -> Real {
        match (self.reached, self.is_ahead()) {
            (true, _) => 0.0,
            (false, true) => (self.goal_s_m - s_m).max(0.0),
            (false, false) => self.left_m,
        }
    }

    /// Speed of the log at the goal, 0 where it stands there, m/s; any speed will do once it is reached.
    pub(crate) fn goal_speed_mps(&self) -> Real {
        if self.reached { Real::MAX } else { self.goal_speed_mps }
    }

    /// Numbers that must be finite.
    pub(crate) fn reals(&self) -> [Real; 8] {
        let Self { start_s_m, goal_s_m, best_s_m, goal, apart_m, left_m, goal_speed_mps, .. } = self;
        [*start_s_m, *goal_s_m, *best_s_m, goal.x, goal.y, *apart_m, *left_m, *goal_speed_mps]
    }
}
