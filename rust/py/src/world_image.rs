//! Images of a running world.

use crate::drivers;
use crate::render::{CentreArg, from_render, layers_of, pixels, to_array};
use ccdiff_bridge::errors::{from_sim, py};
use ccdiff_render::{AgentBox, Camera, DrawStyle, Drawing, Line, Theme, legend_of, name_of, render};
use ccdiff_sim::Result;
use ccdiff_sim::geom::{Point2, Pose2};
use ccdiff_sim::scene::EGO_ID;
use ccdiff_sim::world::{VecWorld, WorldStatus};
use numpy::PyArray3;
use pyo3::prelude::*;
use std::collections::VecDeque;

/// What an image of a world takes.
pub(crate) struct ViewOptions {
    pub(crate) size: (i64, i64),
    pub(crate) span_m: f32,
    /// The first slot's agent by default.
    pub(crate) centre: Option<CentreArg>,
    pub(crate) heading_up: bool,
    pub(crate) route: bool,
    pub(crate) labels: bool,
    pub(crate) theme: Theme,
}

/// Where the agents of each world were in the last steps.
pub(crate) struct Trails {
    num_steps: usize,
    worlds: Vec<Trail>,
}

/// Past positions [T][A] of one world, oldest first; `None` where an agent was absent.
pub(crate) type Trail = VecDeque<Vec<Option<Point2>>>;

impl Trails {
    pub(crate) fn new(num_worlds: usize, num_steps: usize) -> Self {
        Self { num_steps, worlds: vec![Trail::new(); num_worlds] }
    }

    pub(crate) fn of(&self, world_idx: usize) -> Option<&Trail> {
        self.worlds.get(world_idx)
    }

    /// Drops what is known of a world's past.
    pub(crate) fn forget(&mut self, world_idx: usize) {
        self.worlds[world_idx].clear();
    }

    /// Begins with the log that leads up to an episode.
    pub(crate) fn restart(&mut self, world: &VecWorld, world_idx: usize) -> Result<()> {
        let status = world.status(world_idx)?;
        let scene = world.scene(status.scene_idx)?;
        let past = |t: usize| {
            let at = |a| scene.is_valid(a, t).then(|| scene.tracks.position[scene.at(a, t)]);
            (0..scene.num_agents()).map(at).collect()
        };
        let first = (status.step_idx + 1).saturating_sub(self.num_steps);
        self.worlds[world_idx] = (first..=status.step_idx).map(past).collect();
        Ok(())
    }

    /// Takes the present of every world that went on.
    pub(crate) fn follow(
        &mut self,
        world: &VecWorld,
        active: Option<&[bool]>,
        was_reset: &[bool],
    ) -> Result<()> {
        for (i, was_reset) in was_reset.iter().enumerate() {
            if active.is_some_and(|active| !active[i]) {
                continue;
            }
            if *was_reset {
                self.restart(world, i)?;
                continue;
            }
            let states = world.status(i)?.states;
            let trail = &mut self.worlds[i];
            if trail.len() >= self.num_steps {
                trail.pop_front();
            }
            trail
                .push_back((0..states.len()).map(|a| states.active[a].then(|| states.position(a))).collect());
        }
        Ok(())
    }
}

/// Points of one agent up to now, after its last absence.
fn trail_of(trail: &Trail, agent_idx: usize) -> Vec<Point2> {
    let newest_first = trail.iter().rev().map(|row| row.get(agent_idx).copied().flatten());
    let mut points: Vec<Point2> = newest_first.take_while(Option::is_some).flatten().collect();
    points.reverse();
    points
}

/// The stretch of a route from the point nearest to an agent to the one nearest to its goal.
fn route_ahead(points: &[Point2], from: Point2, goal: Point2) -> &[Point2] {
    let nearest = |points: &[Point2], to: Point2| {
        let by_distance = |i: &usize, j: &usize| {
            (points[*i] - to).norm_squared().total_cmp(&(points[*j] - to).norm_squared())
        };
        (0..points.len()).min_by(by_distance).unwrap_or(0)
    };
    let ahead = &points[nearest(points, from)..];
    &ahead[..(nearest(ahead, goal) + 1).min(ahead.len())]
}

fn middle(p: Point2, q: Point2) -> Point2 {
    p + 0.5 * (q - p)
}

fn caption(name: &str, dt_s: f32, status: &WorldStatus<'_>, focus: Option<usize>) -> String {
    let time_s = f64::from(dt_s) * status.elapsed_steps as f64;
    let speed = focus.map(|a| format!("  {:.1} m/s", status.states.speed_mps[a])).unwrap_or_default();
    format!("{name}  {time_s:.1} s{speed}")
}

/// Draws a world: map, route of the agent in focus, trails, agents, collisions of agents with a slot.
pub(crate) fn draw<'py>(
    py: Python<'py>,
    world: &VecWorld,
    world_idx: usize,
    trail: Option<Option<&Trail>>,
    view: ViewOptions,
) -> PyResult<Bound<'py, PyArray3<u8>>> {
    let status = world.status(world_idx).map_err(from_sim)?;
    let scene = world.scene(status.scene_idx).map_err(from_sim)?;
    let slots = world.slot_agents(world_idx).map_err(from_sim)?;
    let states = status.states;
    let focus_slot = slots.iter().position(Option::is_some);
    let focus = focus_slot.and_then(|c| slots[c]);
    let pose = match view.centre {
        Some(CentreArg::Point((x, y))) => Pose2::new(x, y, std::f32::consts::FRAC_PI_2),
        Some(CentreArg::Id(id)) => states.pose(scene.agent_index(&id).ok_or_else(|| {
            py::UnknownNameError::new_err(format!("scene {:?} has no agent {id:?}", scene.name))
        })?),
        None => focus.map_or_else(|| Pose2::new(0.0, 0.0, 0.0), |a| states.pose(a)),
    };
    let is_guided = |a: usize, name: &str| {
        let plan = world.explain(world_idx, Some(name)).ok().flatten();
        plan.is_some_and(|p| p.agents.iter().zip(&p.guided).any(|(b, on)| *b == a && *on))
    };
    let colour_of = |a: usize| {
        let (name, kind) = world.driver_name(status.drivers[a]);
        match drivers::drawn(kind) {
            _ if is_guided(a, name) => DrawStyle::Adversary,
            _ if scene.agents[a].id == EGO_ID => DrawStyle::Ego,
            driver => driver,
        }
    };
    let drawn: Vec<DrawStyle> = (0..states.len()).map(colour_of).collect();
    let in_contact: Vec<(usize, usize)> = world
        .contacts(world_idx)
        .map_err(from_sim)?
        .iter()
        .map(|(of_i, of_j)| (of_j.partner as usize, of_i.partner as usize))
        .filter(|(i, j)| slots.contains(&Some(*i)) || slots.contains(&Some(*j)))
        .collect();
    let boxes: Vec<AgentBox> = (0..states.len())
        .filter(|a| states.active[*a])
        .map(|a| AgentBox {
            pose: states.pose(a),
            length_m: scene.agents[a].length_m,
            width_m: scene.agents[a].width_m,
            kind: scene.agents[a].kind,
            driver: drawn[a],
            collided: in_contact.iter().any(|(i, j)| *i == a || *j == a),
        })
        .collect();
    let marks: Vec<Point2> =
        in_contact.iter().map(|(i, j)| middle(states.position(*i), states.position(*j))).collect();
    let past: Vec<(Vec<Point2>, DrawStyle)> = match trail.flatten() {
        Some(trail) => {
            let movers =
                (0..states.len()).filter(|a| scene.agents[*a].kind != ccdiff_sim::scene::AgentKind::Static);
            movers.map(|a| (trail_of(trail, a), drawn[a])).collect()
        }
        None => Vec::new(),
    };
    let trails: Vec<Line<'_>> =
        past.iter().map(|(points, driver)| Line { points, driver: *driver }).collect();
    let way = match focus_slot.filter(|_| view.route) {
        Some(c) => world.slot_route(world_idx, c).map_err(from_sim)?,
        None => None,
    };
    let route = match (&way, focus) {
        (Some((points, goal)), Some(a)) => route_ahead(points, states.position(a), *goal),
        _ => &[],
    };
    let (caption, names, legend) = if view.labels {
        let title_of = |a: usize| match drawn[a] {
            style @ (DrawStyle::Ego | DrawStyle::Adversary) => (style, style.title()),
            style => (style, drivers::title(world.driver_name(status.drivers[a]).1)),
        };
        let there = (0..states.len()).filter(|a| states.active[*a]);
        (
            caption(&scene.name, scene.dt_s, &status, focus),
            there.map(|a| name_of(scene, a)).collect(),
            legend_of(scene, (0..states.len()).map(title_of), view.theme),
        )
    } else {
        (String::new(), Vec::new(), Vec::new())
    };
    let (width, height) = pixels(view.size)?;
    let camera = Camera::over(pose.position, view.span_m, width, height);
    let camera = if view.heading_up { camera.heading_up(pose.heading_rad) } else { camera };
    let layers = layers_of(&scene.map)?;
    let drawing = Drawing {
        map: Some(&layers),
        route,
        trails: &trails,
        boxes: &boxes,
        names: &names,
        collisions: &marks,
        caption: &caption,
        scale_bar: view.labels,
        legend: &legend,
        theme: view.theme,
        ..Drawing::default()
    };
    let image = py.detach(|| render(&drawing, &camera)).map_err(from_render)?;
    to_array(py, image)
}
