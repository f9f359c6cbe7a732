//! States of the agents of a scene over the last steps: what the network's inputs are made from.

use crate::error::{ModelError, Result};
use ccdiff_sim::causal::measures::{AgentFrame, Ttc};
use ccdiff_sim::geom::{OrientedBox, Point2, Pose2, Vector2};
use ccdiff_sim::scene::Scene;
use ccdiff_sim::stage::{History, Route, apart_in_log};

/// States of A agents over the last H steps in the scene frame; row-major [A, H], the last step is now.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Window {
    /// Number of steps H.
    pub num_steps: usize,
    /// Centre x, metres, [A, H].
    pub x_m: Vec<f32>,
    /// Centre y, metres, [A, H].
    pub y_m: Vec<f32>,
    /// Heading, radians, [A, H].
    pub heading_rad: Vec<f32>,
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
    /// Times to contact of all agents at every step, seconds, [H, A, A]; empty where nobody has computed them yet.
    pub ttc_s: Vec<f32>,
    /// Which pairs of agents are on different levels now, [A, A]; empty: none.
    pub apart: Vec<bool>,
    /// Places ahead on each agent's route, scene frame, [A]\[P\], see [`route_ahead`]; empty for an agent whose route is
    /// not told, and empty as a whole where nobody's is.
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
                window.x_m.push(past.position.x);
                window.y_m.push(past.position.y);
                window.heading_rad.push(past.heading_rad);
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

    /// Checks the lengths of all arrays.
    ///
    /// # Errors
    /// [`ModelError::Shape`] names the first that does not fit.
    pub fn check(&self, num_steps: usize) -> Result<()> {
        let (agents, entries) = (self.num_agents(), self.num_agents() * num_steps);
        for (what, got, expected) in [
            ("window steps", self.num_steps, num_steps),
            ("window x_m", self.x_m.len(), entries),
            ("window y_m", self.y_m.len(), entries),
            ("window heading_rad", self.heading_rad.len(), entries),
            ("window speed_mps", self.speed_mps.len(), entries),
            ("window valid", self.valid.len(), entries),
            ("window width_m", self.width_m.len(), agents),
            ("window noise_seed", self.noise_seed.len().max(agents), agents),
            ("window ttc_s", self.ttc_s.len().max(entries * agents), entries * agents),
            ("window apart", self.apart.len().max(agents * agents), agents * agents),
            ("window routes", self.routes.len().max(agents), agents),
        ] {
            if got != expected {
                return Err(ModelError::Shape { what, got: got.to_string(), expected: expected.to_string() });
            }
        }
        Ok(())
    }

    /// Computes the times to contact of all agents at every step, once for the ranking and the network.
    ///
    /// # Errors
    /// [`ModelError::Sim`] for arrays of unequal lengths.
    pub fn measure_contacts(&mut self) -> Result<()> {
        let agents: Vec<usize> = (0..self.num_agents()).collect();
        self.ttc_s = self.at_every_step(|step| ttc_at(self, &agents, step))?;
        Ok(())
    }

    /// Distances of all agents at every step, metres, [H, A, A].
    pub fn distance_m(&self) -> Result<Vec<f32>> {
        let agents: Vec<usize> = (0..self.num_agents()).collect();
        self.at_every_step(|step| distance_at(self, &agents, step))
    }

    fn at_every_step(&self, matrix: impl Fn(usize) -> Result<Vec<f32>>) -> Result<Vec<f32>> {
        let matrices = (0..self.num_steps).map(matrix).collect::<Result<Vec<_>>>()?;
        Ok(matrices.into_iter().flatten().collect())
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
        let at = agent * self.num_steps + step;
        Pose2::new(self.x_m[at], self.y_m[at], self.heading_rad[at])
    }

    /// Speed of an agent now.
    pub fn speed_now_mps(&self, agent: usize) -> f32 {
        self.speed_mps[(agent + 1) * self.num_steps - 1]
    }

    /// Whether an agent's body touches another's now.
    pub fn touches_now(&self, agent: usize) -> bool {
        let now = self.num_steps - 1;
        let body = |a: usize| OrientedBox {
            centre: self.pose(a, now).position,
            cos: self.pose(a, now).cos,
            sin: self.pose(a, now).sin,
            half_length_m: 0.5 * self.length_m[a],
            half_width_m: 0.5 * self.width_m[a],
        };
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

    pub(crate) fn velocity(&self, agent: usize, step: usize) -> Vector2 {
        let at = agent * self.num_steps + step;
        self.pose(agent, step).rotate(Vector2::new(self.speed_mps[at], 0.0))
    }

    pub(crate) fn is_valid(&self, agent: usize, step: usize) -> bool {
        self.valid[agent * self.num_steps + step]
    }
}

/// Times to contact [M, M] of some agents at a step, those that the window has where all its agents are meant.
pub(crate) fn ttc_at(window: &Window, agents: &[usize], step: usize) -> Result<Vec<f32>> {
    let pairs = agents.len() * agents.len();
    if agents.len() == window.num_agents() && window.ttc_s.len() == window.num_steps * pairs {
        return Ok(window.ttc_s[step * pairs..(step + 1) * pairs].to_vec());
    }
    let columns = Columns::new(window, agents, step);
    let mut out = vec![0.0; agents.len() * agents.len()];
    columns.frame()?.ttc_s(Ttc::Oriented, &columns.heading, &mut out)?;
    Ok(out)
}

/// Distances [M, M] of some agents at a step, metres.
pub(crate) fn distance_at(window: &Window, agents: &[usize], step: usize) -> Result<Vec<f32>> {
    let mut out = vec![0.0; agents.len() * agents.len()];
    Columns::new(window, agents, step).frame()?.distance_m(&mut out)?;
    Ok(out)
}

/// Columns of the chosen agents at a step.
struct Columns {
    x: Vec<f32>,
    y: Vec<f32>,
    heading: Vec<f32>,
    speed: Vec<f32>,
    length: Vec<f32>,
    width: Vec<f32>,
    valid: Vec<bool>,
    apart: Vec<bool>,
}

impl Columns {
    fn new(window: &Window, agents: &[usize], step: usize) -> Self {
        let pick = |v: &[f32]| agents.iter().map(|a| v[a * window.num_steps + step]).collect();
        Self {
            x: pick(&window.x_m),
            y: pick(&window.y_m),
            heading: pick(&window.heading_rad),
            speed: pick(&window.speed_mps),
            length: agents.iter().map(|a| window.length_m[*a]).collect(),
            width: agents.iter().map(|a| window.width_m[*a]).collect(),
            valid: agents.iter().map(|a| window.is_valid(*a, step)).collect(),
            apart: window.apart_of(agents),
        }
    }

    fn frame(&self) -> Result<AgentFrame<'_>> {
        let frame = AgentFrame {
            x_m: &self.x,
            y_m: &self.y,
            heading_rad: &self.heading,
            speed_mps: &self.speed,
            length_m: &self.length,
            width_m: &self.width,
            valid: &self.valid,
            apart: &self.apart,
        };
        Ok(frame.checked()?)
    }
}
