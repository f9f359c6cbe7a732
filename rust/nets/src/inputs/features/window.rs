//! States of the agents of a scene over the last steps: what the network's inputs are made from.

use ccdiff_sim::causal::measures::{Moving, distance_m, ttc_s};
use ccdiff_sim::geom::{OrientedBox, Point2, Pose2, Vector2};
use ccdiff_sim::scene::Scene;
use ccdiff_sim::stage::{History, Route, apart_in_log};
use ccdiff_sim::state::Footprint;

/// States of A agents over the last H steps in the scene frame; row-major [A, H], the last step is now.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Window {
    /// Number of steps H.
    pub num_steps: usize,
    /// Centres and headings, [A, H].
    pub poses: Vec<Pose2>,
    /// Speed along the heading, metres per second, negative when reversing, [A, H].
    pub speed_mps: Vec<f32>,
    /// Whether the agent was there, [A, H]. Other entries mean nothing where this is false.
    pub valid: Vec<bool>,
    /// Length, metres, [A].
    pub length_m: Vec<f32>,
    /// Width, metres, [A].
    pub width_m: Vec<f32>,
    /// Seed of each agent's own noise, [A]; empty: noise of the world's seed.
    pub noise_seed: Vec<u64>,
    /// Times to contact of all agents at every step, seconds, [H, A, A]; empty until computed.
    pub ttc_s: Vec<f32>,
    /// Which pairs of agents are on different levels now, [A, A]; empty: none.
    pub apart: Vec<bool>,
    /// Places ahead on each agent's route, scene frame, [A]\[P\], see [`route_ahead`]; empty for an agent whose route is
    /// not told, and empty as a whole where none is.
    pub routes: Vec<Vec<Point2>>,
}

/// Places on a route at some distances ahead of the position `s_m` along it, metres, scene frame.
///
/// Differs from the paper: its network is told no route. Routes are those of the rule-based traffic: the path of the log,
/// then the lanes ahead. They tell where a vehicle goes, not when.
pub fn route_ahead(route: &Route, s_m: f32, points_m: &[f32]) -> Vec<Point2> {
    points_m.iter().map(|ahead_m| route.path.at(s_m + ahead_m).position).collect()
}

impl Window {
    /// The window of some agents of a scene that ends at a step; steps before the scene's start are not valid.
    pub fn from_scene(scene: &Scene, step_idx: usize, agents: &[usize], num_steps: usize) -> Self {
        let history = History::from_log(scene, step_idx, num_steps);
        let apart = apart_in_log(scene, step_idx, agents);
        Self { apart, ..Self::from_history(&history, scene, agents, num_steps) }
    }

    /// The last `num_steps` states of some agents of a scene, of a history that has so many at least.
    pub fn from_history(history: &History, scene: &Scene, agents: &[usize], num_steps: usize) -> Self {
        let mut window = Self { num_steps, ..Self::default() };
        for &agent in agents {
            window.length_m.push(scene.agents[agent].length_m);
            window.width_m.push(scene.agents[agent].width_m);
            for k in history.len() - num_steps..history.len() {
                let past = history.at(agent, k);
                window.poses.push(Pose2::new(past.position.x, past.position.y, past.heading_rad));
                window.speed_mps.push(past.speed_mps);
                window.valid.push(past.valid);
            }
        }
        window
    }

    /// Number of agents A.
    pub fn num_agents(&self) -> usize {
        self.length_m.len()
    }

    /// Computes the times to contact of all agents at every step, once for the ranking and the network.
    pub fn measure_contacts(&mut self) {
        let agents: Vec<usize> = (0..self.num_agents()).collect();
        self.ttc_s = (0..self.num_steps).flat_map(|step| ttc_at(self, &agents, step)).collect();
    }

    /// Distances of all agents at every step, metres, [H, A, A].
    pub fn distance_m(&self) -> Vec<f32> {
        let agents: Vec<usize> = (0..self.num_agents()).collect();
        (0..self.num_steps).flat_map(|step| distance_at(self, &agents, step)).collect()
    }

    /// Tells the agents' routes, in the agents' order, from where they are now.
    pub fn tell_routes<'a>(&mut self, routes: impl IntoIterator<Item = &'a Route>, points_m: &[f32]) {
        let ahead = |(agent, route): (usize, &Route)| {
            let at = self.pose(agent, self.num_steps - 1).position;
            route_ahead(route, route.path.project(at).s_m, points_m)
        };
        self.routes = routes.into_iter().enumerate().map(ahead).collect();
    }

    /// Pose of an agent at a step.
    pub fn pose(&self, agent: usize, step: usize) -> Pose2 {
        self.poses[agent * self.num_steps + step]
    }

    /// Speed of an agent now.
    pub fn speed_now_mps(&self, agent: usize) -> f32 {
        self.speed_mps[(agent + 1) * self.num_steps - 1]
    }

    /// Whether an agent's body touches another's now.
    pub fn touches_now(&self, agent: usize) -> bool {
        let now = self.num_steps - 1;
        let body = |a: usize| self.body(a, now);
        let own = body(agent);
        let meets = |a: usize| a != agent && self.is_valid(a, now) && !self.is_apart(agent, a);
        (0..self.num_agents()).any(|a| meets(a) && body(a).overlaps(&own))
    }

    /// Whether two agents are on different levels.
    pub fn is_apart(&self, i: usize, j: usize) -> bool {
        self.apart.get(i * self.num_agents() + j).copied().unwrap_or(false)
    }

    /// Which pairs of some agents are on different levels; empty: none.
    pub(crate) fn apart_of(&self, agents: &[usize]) -> Vec<bool> {
        let agents = if self.apart.is_empty() { &[] } else { agents };
        agents.iter().flat_map(|i| agents.iter().map(|j| self.is_apart(*i, *j))).collect()
    }

    /// Box of an agent at a step.
    fn body(&self, agent: usize, step: usize) -> OrientedBox {
        Footprint::new(self.length_m[agent], self.width_m[agent]).at(&self.pose(agent, step))
    }

    /// Some agents at a step.
    fn moving(&self, agents: &[usize], step: usize) -> Vec<Moving> {
        let moving = |a: usize| (self.body(a, step), self.velocity(a, step));
        agents.iter().map(|a| self.is_valid(*a, step).then(|| moving(*a))).collect()
    }

    pub(crate) fn velocity(&self, agent: usize, step: usize) -> Vector2 {
        let at = agent * self.num_steps + step;
        self.pose(agent, step).rotate(Vector2::new(self.speed_mps[at], 0.0))
    }

    pub(crate) fn is_valid(&self, agent: usize, step: usize) -> bool {
        self.valid[agent * self.num_steps + step]
    }
}

/// Times to contact [M, M] of some agents at a step, those that the window has where all its agents are meant.
pub(crate) fn ttc_at(window: &Window, agents: &[usize], step: usize) -> Vec<f32> {
    let pairs = agents.len() * agents.len();
    if agents.len() == window.num_agents() && window.ttc_s.len() == window.num_steps * pairs {
        return window.ttc_s[step * pairs..(step + 1) * pairs].to_vec();
    }
    ttc_s(&window.moving(agents, step), &window.apart_of(agents))
}

/// Distances [M, M] of some agents at a step, metres.
pub(crate) fn distance_at(window: &Window, agents: &[usize], step: usize) -> Vec<f32> {
    distance_m(&window.moving(agents, step), &window.apart_of(agents))
}
