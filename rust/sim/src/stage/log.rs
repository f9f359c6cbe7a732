//! The log of a scene step by step, as replay puts it in place of the states of a world.

use crate::geom::{Point2, Pose2, Real, Vector2, math};
use crate::scene::Scene;
use crate::simd_dispatch::{pick, simd_dispatch};
use crate::stage::route::Route;
use crate::state::{AgentStates, Height};
use std::f32::consts::PI;
use std::sync::OnceLock;

/// Columns of [`AgentStates`] that a log has: x, y, heading, cosine, sine, speed, velocity x and y.
const NUM_COLUMNS: usize = 8;
const HEADING: usize = 2;
const SPEED: usize = 5;
/// Slopes are taken over this at least to either side, metres, within so many steps, and are at most so steep.
const GRADE_M: Real = 5.0;
const GRADE_STEPS: usize = 100;
pub(super) const STEEPEST: Real = 0.3;

/// Logged states of A agents at T steps, each column [T, A].
#[derive(Debug)]
pub(crate) struct Log {
    num_agents: usize,
    columns: [Vec<Real>; NUM_COLUMNS],
    valid: Vec<bool>,
    /// How high the agents are [T, A], in scenes with levels.
    heights: Vec<Height>,
    /// The step after the last logged one of each agent.
    end_step: Vec<usize>,
    /// Positions along the route [T] of each agent, made when they are first asked for.
    pub(crate) route_s_m: Vec<OnceLock<Box<[Real]>>>,
}

impl Log {
    /// The log of a scene.
    pub(crate) fn new(scene: &Scene) -> Self {
        let (num_agents, num_steps) = (scene.num_agents(), scene.num_steps);
        let mut states = AgentStates::new(num_agents * num_steps);
        for (step_idx, first) in (0..num_steps).map(|t| (t, t * num_agents)) {
            for a in (0..num_agents).filter(|a| scene.is_valid(*a, step_idx)) {
                let velocity = scene.tracks.velocity[scene.at(a, step_idx)];
                states.set_pose(first + a, scene.pose(a, step_idx), velocity);
                states.active[first + a] = true;
            }
        }
        let AgentStates { x, y, heading_rad, cos, sin, speed_mps, velocity_x_mps, velocity_y_mps, .. } =
            states;
        let end = |a| (0..num_steps).rev().find(|t| scene.is_valid(a, *t)).map_or(0, |t| t + 1);
        let end_step = (0..num_agents).map(end).collect();
        Self {
            num_agents,
            columns: [x, y, heading_rad, cos, sin, speed_mps, velocity_x_mps, velocity_y_mps],
            valid: states.active,
            heights: heights(scene),
            end_step,
            route_s_m: (0..num_agents).map(|_| OnceLock::new()).collect(),
        }
    }

    /// Whether the log has an agent at a step or at a later one.
    #[inline]
    pub(crate) fn goes_on(&self, agent_idx: usize, step_idx: usize) -> bool {
        step_idx < self.end_step[agent_idx]
    }

    /// Whether the log has an agent at a step.
    #[inline]
    pub(crate) fn has(&self, agent_idx: usize, step_idx: usize) -> bool {
        self.valid.get(step_idx * self.num_agents + agent_idx).is_some_and(|valid| *valid)
    }

    /// Whether the log has an agent again at a step, which it had last at most some steps ago.
    pub(crate) fn has_again(&self, agent_idx: usize, step_idx: usize, steps: usize) -> bool {
        let has = |t: usize| self.has(agent_idx, t);
        let first = step_idx.saturating_sub(steps);
        has(step_idx) && step_idx > first && !has(step_idx - 1) && (first..step_idx).any(has)
    }

    /// Acceleration (m/s²) and yaw rate (rad/s) at a logged step, over the step before or else the next one; else zero.
    pub(crate) fn rates(&self, agent_idx: usize, step_idx: usize, dt_s: Real) -> (Real, Real) {
        let at = |t: usize| {
            let at = t * self.num_agents + agent_idx;
            self.has(agent_idx, t).then(|| (self.columns[SPEED][at], self.columns[HEADING][at]))
        };
        let (before, here) = (step_idx.checked_sub(1).and_then(at), at(step_idx));
        let (from, to) = if before.is_some() { (before, here) } else { (here, at(step_idx + 1)) };
        let (Some((speed, heading)), Some((next_speed, next_heading))) = (from, to) else {
            return (0.0, 0.0);
        };
        ((next_speed - speed) / dt_s, math::wrap_angle(next_heading - heading) / dt_s)
    }

    /// Positions along its route of an agent [T], followed from the start of the log on.
    pub(crate) fn along(&self, agent_idx: usize, route: &Route) -> Box<[Real]> {
        let (mut s_m, mut last) = (0.0, None);
        let follow = |t| {
            if let Some(point) = self.position(agent_idx, t) {
                let moved_m = last.map_or(0.0, |last: Point2| (point - last).norm());
                s_m = route.advance(point, s_m, moved_m);
                last = Some(point);
            }
            s_m
        };
        (0..self.valid.len() / self.num_agents).map(follow).collect()
    }

    /// Pose and velocity of an agent at a step; `None` where it is not logged.
    #[inline]
    pub(crate) fn at(&self, agent_idx: usize, step_idx: usize) -> Option<(Pose2, Vector2)> {
        if !self.has(agent_idx, step_idx) {
            return None;
        }
        let at = step_idx * self.num_agents + agent_idx;
        let [x, y, heading_rad, cos, sin, _, vx, vy] = std::array::from_fn(|column| self.columns[column][at]);
        Some((Pose2 { position: [x, y].into(), heading_rad, cos, sin }, Vector2::new(vx, vy)))
    }

    /// How high an agent is at a step, in scenes with levels; where it is not logged it means nothing.
    #[inline]
    pub(crate) fn height(&self, agent_idx: usize, step_idx: usize) -> Option<Height> {
        self.heights.get(step_idx * self.num_agents + agent_idx).copied()
    }

    /// Position of an agent at a step; `None` where it is not logged.
    #[inline]
    pub(crate) fn position(&self, agent_idx: usize, step_idx: usize) -> Option<Point2> {
        let at = step_idx * self.num_agents + agent_idx;
        self.has(agent_idx, step_idx).then(|| [self.columns[0][at], self.columns[1][at]].into())
    }

    /// Moves the agents of `follow` [A] to a step; those not logged there leave. `goes` [A] is memory to work in.
    pub(crate) fn follow(
        &self,
        step_idx: usize,
        follow: &[bool],
        states: &mut AgentStates,
        goes: &mut Vec<u32>,
        dt_s: Real,
    ) {
        let here = step_idx * self.num_agents..(step_idx + 1) * self.num_agents;
        let Some(valid) = self.valid.get(here.clone()) else {
            states.active.iter_mut().zip(follow).for_each(|(active, follow)| *active &= !follow);
            return;
        };
        goes.clear();
        for ((active, follow), valid) in states.active.iter_mut().zip(follow).zip(valid) {
            *active &= !(follow & !valid);
            goes.push(if follow & valid { u32::MAX } else { 0 });
        }
        let log = std::array::from_fn(|column| &self.columns[column][here.clone()]);
        let s = states;
        let turns = || log[HEADING].iter().zip(&s.heading_rad).zip(&*goes);
        let wraps = |((to, from), goes): ((&Real, &Real), &u32)| {
            let turn = to - from;
            (*goes != 0) & !(turn > -PI && turn <= PI)
        };
        // hardly ever: else the rates are those of other numbers
        if turns().fold(false, |any, turn| any | wraps(turn)) {
            for (rate, ((to, from), goes)) in s.yaw_rate_radps.iter_mut().zip(turns()) {
                *rate = pick(*goes, math::wrap_angle(to - from) / dt_s, *rate);
            }
        } else {
            take_rates(log[HEADING], &s.heading_rad, goes, dt_s, &mut s.yaw_rate_radps);
        }
        take_rates(log[SPEED], &s.speed_mps, goes, dt_s, &mut s.acceleration_mps2);
        let [columns @ .., _, _] = s.columns_mut();
        take(&log, goes, columns.map(Vec::as_mut_slice));
        if let Some(heights) = self.heights.get(here) {
            for ((to, from), goes) in s.heights.iter_mut().zip(heights).zip(&*goes) {
                *to = if *goes == 0 { *to } else { *from };
            }
        }
    }
}

/// How high agents are at all steps [T, A]; nothing where the scene is flat.
fn heights(scene: &Scene) -> Vec<Height> {
    let steps = if scene.has_levels() { scene.num_steps } else { 0 };
    (0..steps).flat_map(|t| (0..scene.num_agents()).map(move |a| height(scene, a, t))).collect()
}

/// How high an agent is logged at a step of a scene with levels; where it is not logged it means nothing.
fn height(scene: &Scene, agent_idx: usize, step_idx: usize) -> Height {
    if !scene.is_valid(agent_idx, step_idx) {
        return Height::default();
    }
    let (tracks, at) = (&scene.tracks, scene.at(agent_idx, step_idx));
    // the slope from the last place some way back to the next one some way ahead
    let is_far = |k: &usize| (tracks.position[*k] - tracks.position[at]).norm() >= GRADE_M;
    let there = |k: &usize| tracks.valid[*k];
    let before = (scene.at(agent_idx, 0)..at).rev().take(GRADE_STEPS).take_while(there).find(is_far);
    let after = (at + 1..scene.at(agent_idx + 1, 0)).take(GRADE_STEPS).take_while(there).find(is_far);
    let [from, to] = [before.unwrap_or(at), after.unwrap_or(at)];
    let way = tracks.position[to] - tracks.position[from];
    let (sin, cos) = math::sin_cos(tracks.heading_rad[at]);
    let ahead_m = way.x * cos + way.y * sin;
    let rise_m = tracks.elevation_m[to] - tracks.elevation_m[from];
    let grade = if ahead_m.abs() >= GRADE_M { rise_m / ahead_m } else { 0.0 };
    Height { elevation_m: tracks.elevation_m[at], grade: grade.clamp(-STEEPEST, STEEPEST) }
}

/// Which pairs of some agents are on different levels where they are logged at a step, [M, M]; empty in a flat scene.
pub fn apart_in_log(scene: &Scene, step_idx: usize, agents: &[usize]) -> Vec<bool> {
    if !scene.has_levels() {
        return Vec::new();
    }
    let mut states = AgentStates::new(scene.num_agents());
    for a in (0..scene.num_agents()).filter(|a| scene.is_valid(*a, step_idx)) {
        states.set_pose(a, scene.pose(a, step_idx), Vector2::zeros());
    }
    states.heights = (0..scene.num_agents()).map(|a| height(scene, a, step_idx)).collect();
    states.apart(agents)
}

simd_dispatch! {
    /// Puts numbers of columns in the place of others where the masks say so.
    fn take(from: &[&[Real]; NUM_COLUMNS], masks: &[u32], to: [&mut [Real]; NUM_COLUMNS]) {
        for (from, to) in from.iter().zip(to) {
            for ((to, from), mask) in to.iter_mut().zip(*from).zip(masks) {
                *to = pick(*mask, *from, *to);
            }
        }
    }

    /// The same of the rate at which numbers change to those.
    fn take_rates(from: &[Real], before: &[Real], masks: &[u32], dt_s: Real, to: &mut [Real]) {
        for (((to, from), before), mask) in to.iter_mut().zip(from).zip(before).zip(masks) {
            *to = pick(*mask, (from - before) / dt_s, *to);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::synthetic::GridCity;

    const DT_S: Real = 0.1;

    /// A city whose agents come, go and come again.
    fn scene() -> Scene {
        let mut scene = GridCity { num_agents: 19, ..GridCity::default() }.scene();
        for a in 0..scene.num_agents() {
            for t in (0..scene.num_steps).filter(|t| (t + 7 * a) % 23 < a % 5) {
                let at = scene.at(a, t);
                scene.tracks.valid[at] = false;
            }
        }
        scene
    }

    fn near(got: Real, expected: f64) {
        assert!((f64::from(got) - expected).abs() < 1e-3, "{got} {expected}");
    }

    #[test]
    fn followers_are_where_the_tracks_say_and_change_as_these_do() {
        let scene = scene();
        let (log, n, mut masks) = (Log::new(&scene), scene.num_agents(), Vec::new());
        let follow: Vec<bool> = (0..n).map(|a| a % 6 != 1).collect();
        let mut states = AgentStates::new(n);
        states.active.fill(true);
        states.heading_rad = (0..n).map(|a| scene.tracks.heading_rad[scene.at(a, 0)]).collect();
        for t in 0..scene.num_steps {
            let before = states.clone();
            log.follow(t, &follow, &mut states, &mut masks, DT_S);
            for a in 0..n {
                let (at, logged) = (scene.at(a, t), log.at(a, t));
                let (valid, velocity) = (scene.tracks.valid[at], scene.tracks.velocity[at]);
                let expected = valid.then(|| (scene.pose(a, t), velocity));
                assert_eq!((logged, log.position(a, t)), (expected, expected.map(|(pose, _)| pose.position)));
                if !follow[a] {
                    assert_eq!((states.x[a], states.speed_mps[a], states.active[a]), (0.0, 0.0, true));
                    continue;
                }
                assert_eq!(states.active[a], before.active[a] && valid, "agent {a} step {t}");
                if let Some((pose, velocity)) = expected {
                    assert_eq!((pose, velocity), (states.pose(a), states.velocity(a)));
                    let heading = f64::from(pose.heading_rad);
                    let speed = f64::from(velocity.x) * heading.cos() + f64::from(velocity.y) * heading.sin();
                    near(states.speed_mps[a], speed);
                    near(states.acceleration_mps2[a] * DT_S, speed - f64::from(before.speed_mps[a]));
                    let turn = heading - f64::from(before.heading_rad[a]);
                    near(states.yaw_rate_radps[a] * DT_S, turn.sin().atan2(turn.cos()));
                }
            }
        }
        // past the log's end
        log.follow(scene.num_steps, &follow, &mut states, &mut masks, DT_S);
        assert!((0..n).all(|a| states.active[a] != follow[a]) && log.at(0, scene.num_steps).is_none());
    }
}
