//! Images of a scene's log: what stands where at a step, trails and the ego's route.

use crate::agents::AgentBox;
use crate::camera::Camera;
use crate::drawing::{Drawing, render};
use crate::error::{RenderError, Result};
use crate::image::Image;
use crate::layers::MapLayers;
use crate::lines::Line;
use crate::look::{PARKED_M, TRAIL_S};
use crate::palette::{DrawStyle, Rgb, Theme};
use ccdiff_sim::geom::{Point2, Pose2, Real};
use ccdiff_sim::scene::{Agent, AgentKind, EGO_ID, Scene};
use std::collections::BTreeSet;

/// What the middle of an image follows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Centre {
    /// An agent, by its index in the scene.
    Agent(usize),
    /// A fixed point of the scene frame, metres.
    Point(Point2),
}

/// An image of one step of a log.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LogView {
    /// Step of the log.
    pub step_idx: usize,
    /// What is in the middle.
    pub centre: Centre,
    /// Metres across the image's width.
    pub span_m: Real,
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Whether the heading of the agent in the middle points to the top; else north does.
    pub heading_up: bool,
    /// Whether the last three seconds of every agent are drawn.
    pub trails: bool,
    /// Whether the rest of the ego's log is drawn as its route.
    pub route: bool,
    /// Whether the scene's name, time, the ego's speed, names of agents, a scale bar and a legend are written.
    pub labels: bool,
    /// Ground and colours.
    pub theme: Theme,
}

/// Draws one step of a log.
///
/// An agent in the middle that is not logged at the step is looked for at the nearest step that has it.
///
/// # Errors
/// [`RenderError::Step`] past the end, [`RenderError::Centre`] for an agent that does not exist or is never logged,
/// and for `heading_up` without an agent; and those of [`render`].
pub fn render_log(scene: &Scene, map: &MapLayers, log_view: &LogView) -> Result<Image> {
    let step_idx = log_view.step_idx;
    if step_idx >= scene.num_steps {
        return Err(RenderError::Step { got: step_idx, num_steps: scene.num_steps });
    }
    let boxes = logged_boxes(scene, step_idx);
    let num_back = if log_view.trails { (TRAIL_S / scene.dt_s).ceil() as usize + 1 } else { 0 };
    let movers = (0..scene.num_agents()).filter(|a| scene.agents[*a].kind != AgentKind::Static);
    let trails: Vec<(Vec<Point2>, DrawStyle)> =
        movers.map(|a| (logged_trail(scene, a, step_idx, num_back), driver_of(scene, a))).collect();
    let trails: Vec<Line<'_>> =
        trails.iter().map(|(points, driver)| Line { points, driver: *driver }).collect();
    let ego = scene.agent_index(EGO_ID);
    let route = ego.filter(|_| log_view.route).map(|a| logged_future(scene, a, step_idx)).unwrap_or_default();
    let (caption, names, legend) = if log_view.labels {
        let there = (0..scene.num_agents()).filter(|a| scene.is_valid(*a, step_idx));
        let titled = (0..scene.num_agents()).map(|a| (driver_of(scene, a), driver_of(scene, a).title()));
        let names = there.map(|a| name_of(ego, a)).collect();
        let seen = ego.filter(|a| scene.is_valid(*a, step_idx));
        let speed_mps = seen.map(|a| scene.tracks.velocity[scene.at(a, step_idx)].norm());
        (caption(scene, step_idx, speed_mps), names, legend_of(scene, titled, log_view.theme))
    } else {
        (String::new(), Vec::new(), Vec::new())
    };
    let drawing = Drawing {
        map: Some(map),
        route: &route,
        trails: &trails,
        boxes: &boxes,
        names: &names,
        caption: &caption,
        scale_bar: log_view.labels,
        legend: &legend,
        theme: log_view.theme,
        ..Drawing::default()
    };
    render(&drawing, &camera(scene, log_view)?)
}

fn camera(scene: &Scene, log_view: &LogView) -> Result<Camera> {
    let over = |centre| Camera::over(centre, log_view.span_m, log_view.width, log_view.height);
    let fail = |got, expected| Err(RenderError::Centre { got, expected });
    match log_view.centre {
        Centre::Point(_) if log_view.heading_up => {
            fail("a point".into(), "an agent, for an image with heading up")
        }
        Centre::Point(p) => Ok(over(p)),
        Centre::Agent(a) if a >= scene.num_agents() => {
            fail(format!("agent {a}"), "the index of an agent of the scene")
        }
        Centre::Agent(a) => match nearest_logged_pose(scene, a, log_view.step_idx) {
            Some(pose) if log_view.heading_up => Ok(over(pose.position).heading_up(pose.heading_rad)),
            Some(pose) => Ok(over(pose.position)),
            None => fail(format!("agent {:?}", scene.agents[a].id), "an agent that is logged at some step"),
        },
    }
}

/// Name, time and the speed of who is looked at, m/s.
pub(crate) fn caption(scene: &Scene, steps: usize, speed_mps: Option<Real>) -> String {
    let time_s = f64::from(scene.dt_s) * steps as f64;
    let speed = speed_mps.map(|speed| format!("  {speed:.1} m/s")).unwrap_or_default();
    format!("{}  {time_s:.1} s{speed}", scene.name)
}

/// What an agent is called in images, as on the replay page: `ego`, or its number in the scene.
pub fn name_of(ego: Option<usize>, agent_idx: usize) -> String {
    if ego == Some(agent_idx) { EGO_ID.to_owned() } else { agent_idx.to_string() }
}

/// Colours and titles of a legend: everybody in a scene once, in the order of [`DrawStyle`], obstacles last.
/// `titled` gives each agent's driver and what it is called.
pub fn legend_of<'a>(
    scene: &Scene,
    titled: impl Iterator<Item = (DrawStyle, &'a str)>,
    theme: Theme,
) -> Vec<(Rgb, String)> {
    let is_obstacle = |a: &Agent| a.kind == AgentKind::Static;
    let movers = scene.agents.iter().zip(titled).filter(|(a, _)| !is_obstacle(a));
    let drivers: BTreeSet<_> = movers.map(|(_, driver)| driver).collect();
    let rows = drivers.into_iter().map(|(driver, title)| (driver.colour(theme), title.to_owned()));
    let obstacle = (theme.palette().obstacle, "obstacle".to_owned());
    rows.chain(scene.agents.iter().any(is_obstacle).then_some(obstacle)).collect()
}

/// Boxes of the agents logged at a step: the ego as [`DrawStyle::Ego`], all others as [`DrawStyle::Replay`]. None past
/// the end.
pub fn logged_boxes(scene: &Scene, step_idx: usize) -> Vec<AgentBox> {
    let present = (0..scene.num_agents()).filter(|a| scene.is_valid(*a, step_idx));
    present
        .map(|agent_idx| {
            let agent = &scene.agents[agent_idx];
            AgentBox {
                pose: logged_pose(scene, agent_idx, step_idx),
                length_m: agent.length_m,
                width_m: agent.width_m,
                kind: agent.kind,
                driver: driver_of(scene, agent_idx),
                collided: false,
                parked: is_parked(scene, agent_idx),
                arrived: false,
            }
        })
        .collect()
}

/// Whether a vehicle never leaves the place at which it is first logged; the ego is never parked.
pub fn is_parked(scene: &Scene, agent_idx: usize) -> bool {
    let agent = &scene.agents[agent_idx];
    let mut places = logged_future(scene, agent_idx, 0).into_iter();
    let Some(first) = places.next().filter(|_| agent.kind == AgentKind::Vehicle && agent.id != EGO_ID) else {
        return false;
    };
    places.all(|place| (place - first).norm() <= PARKED_M)
}

/// Centres of an agent over the last `num_steps` steps up to and with `step_idx`, oldest first; only the part after
/// the last gap in its track.
pub fn logged_trail(scene: &Scene, agent_idx: usize, step_idx: usize, num_steps: usize) -> Vec<Point2> {
    let mut points: Vec<Point2> = (0..=step_idx)
        .rev()
        .take(num_steps)
        .take_while(|step| scene.is_valid(agent_idx, *step))
        .map(|step| scene.tracks.position[scene.at(agent_idx, step)])
        .collect();
    points.reverse();
    points
}

/// Centres of an agent from a step to the end of its log.
pub fn logged_future(scene: &Scene, agent_idx: usize, step_idx: usize) -> Vec<Point2> {
    let steps = (step_idx..scene.num_steps).filter(|step| scene.is_valid(agent_idx, *step));
    steps.map(|step| scene.tracks.position[scene.at(agent_idx, step)]).collect()
}

/// Pose of an agent at a step or, where it is not logged then, at the nearest step before, else after. `None` for
/// an agent that is never logged.
pub fn nearest_logged_pose(scene: &Scene, agent_idx: usize, step_idx: usize) -> Option<Pose2> {
    let last = step_idx.min(scene.num_steps.checked_sub(1)?);
    let mut steps = (0..=last).rev().chain(last + 1..scene.num_steps);
    let step = steps.find(|step| scene.is_valid(agent_idx, *step))?;
    Some(logged_pose(scene, agent_idx, step))
}

/// [`DrawStyle::Ego`] or [`DrawStyle::Replay`].
pub fn driver_of(scene: &Scene, agent_idx: usize) -> DrawStyle {
    if scene.agents[agent_idx].id == EGO_ID { DrawStyle::Ego } else { DrawStyle::Replay }
}

fn logged_pose(scene: &Scene, agent_idx: usize, step_idx: usize) -> Pose2 {
    let at = scene.at(agent_idx, step_idx);
    let p = scene.tracks.position[at];
    Pose2::new(p.x, p.y, scene.tracks.heading_rad[at])
}
