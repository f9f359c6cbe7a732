//! Images of a scene's log: what stands where at a step, trails and the ego's route.

use crate::agents::AgentBox;
use crate::error::{RenderError, Result};
use crate::look::{PARKED_M, TRAIL_S};
use crate::palette::{DrawStyle, Rgb, Theme};
use crate::shown::{Centre, Frame, Shown};
use ccdiff_sim::geom::{Point2, Pose2, Real};
use ccdiff_sim::scene::{Agent, AgentKind, EGO_ID, Scene};
use std::collections::BTreeSet;

impl Shown {
    /// What a step of a log shows, with the last three seconds of every agent if `trails`.
    ///
    /// An agent in the middle that is not logged at the step is looked for at the nearest step that has it.
    ///
    /// # Errors
    /// [`RenderError::Step`] past the end, [`RenderError::Config`] for a middle that does not exist or is never logged,
    /// and for `heading_up` without an agent.
    pub fn of_log(scene: &Scene, step_idx: usize, trails: bool, frame: Frame) -> Result<Self> {
        if step_idx >= scene.num_steps {
            return Err(RenderError::Step { got: step_idx, num_steps: scene.num_steps });
        }
        let ego = scene.agent_index(EGO_ID);
        let mut shown = Self::new(frame, middle(scene, step_idx, ego, &frame)?);
        shown.boxes = logged_boxes(scene, step_idx);
        if trails {
            let num_back = (TRAIL_S / scene.dt_s).ceil() as usize + 1;
            let movers = (0..scene.num_agents()).filter(|a| scene.agents[*a].kind != AgentKind::Static);
            let trail = |a| (logged_trail(scene, a, step_idx, num_back), driver_of(scene, a));
            shown.trails = movers.map(trail).collect();
        }
        if let Some(ego) = ego.filter(|_| frame.route) {
            shown.route = logged_future(scene, ego, step_idx);
        }
        if frame.labels {
            let there = |a: &usize| scene.is_valid(*a, step_idx);
            let titled = (0..scene.num_agents()).map(|a| (driver_of(scene, a), driver_of(scene, a).title()));
            let speed_mps = ego.filter(there).map(|a| scene.tracks.velocity[scene.at(a, step_idx)].norm());
            shown.caption = caption(scene, step_idx, speed_mps);
            shown.names = (0..scene.num_agents()).filter(there).map(|a| name_of(ego, a)).collect();
            shown.legend = legend_of(scene, titled, frame.theme);
        }
        Ok(shown)
    }
}

fn middle(scene: &Scene, step_idx: usize, ego: Option<usize>, frame: &Frame) -> Result<Pose2> {
    let fail = |got, expected: &str| Err(RenderError::config("centre of the image", got, expected));
    match frame.centre.or(ego.map(Centre::Agent)) {
        None => fail("the ego".into(), "an agent of the scene"),
        Some(Centre::Point(_)) if frame.heading_up => {
            fail("a point".into(), "an agent, for an image with heading up")
        }
        Some(Centre::Point(p)) => Ok(Pose2::new(p.x, p.y, 0.0)),
        Some(Centre::Agent(a)) if a >= scene.num_agents() => {
            fail(format!("agent {a}"), "the index of an agent of the scene")
        }
        Some(Centre::Agent(a)) => match nearest_logged_pose(scene, a, step_idx) {
            Some(pose) => Ok(pose),
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
pub(crate) fn name_of(ego: Option<usize>, agent_idx: usize) -> String {
    if ego == Some(agent_idx) { EGO_ID.to_owned() } else { agent_idx.to_string() }
}

/// Colours and titles of a legend: everybody in a scene once, in the order of [`DrawStyle`], obstacles last.
/// `titled` gives each agent's driver and what it is called.
pub(crate) fn legend_of<'a>(
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
fn logged_boxes(scene: &Scene, step_idx: usize) -> Vec<AgentBox> {
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
pub(crate) fn is_parked(scene: &Scene, agent_idx: usize) -> bool {
    let agent = &scene.agents[agent_idx];
    let mut places = logged_future(scene, agent_idx, 0).into_iter();
    let Some(first) = places.next().filter(|_| agent.kind == AgentKind::Vehicle && agent.id != EGO_ID) else {
        return false;
    };
    places.all(|place| (place - first).norm() <= PARKED_M)
}

/// Centres of an agent over the last `num_steps` steps up to and with `step_idx`, oldest first; only the part after
/// the last gap in its track.
fn logged_trail(scene: &Scene, agent_idx: usize, step_idx: usize, num_steps: usize) -> Vec<Point2> {
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
fn logged_future(scene: &Scene, agent_idx: usize, step_idx: usize) -> Vec<Point2> {
    let steps = (step_idx..scene.num_steps).filter(|step| scene.is_valid(agent_idx, *step));
    steps.map(|step| scene.tracks.position[scene.at(agent_idx, step)]).collect()
}

/// Pose of an agent at a step or, where it is not logged then, at the nearest step before, else after. `None` for
/// an agent that is never logged.
fn nearest_logged_pose(scene: &Scene, agent_idx: usize, step_idx: usize) -> Option<Pose2> {
    let last = step_idx.min(scene.num_steps.checked_sub(1)?);
    let mut steps = (0..=last).rev().chain(last + 1..scene.num_steps);
    let step = steps.find(|step| scene.is_valid(agent_idx, *step))?;
    Some(logged_pose(scene, agent_idx, step))
}

/// [`DrawStyle::Ego`] or [`DrawStyle::Replay`].
fn driver_of(scene: &Scene, agent_idx: usize) -> DrawStyle {
    if scene.agents[agent_idx].id == EGO_ID { DrawStyle::Ego } else { DrawStyle::Replay }
}

fn logged_pose(scene: &Scene, agent_idx: usize, step_idx: usize) -> Pose2 {
    let at = scene.at(agent_idx, step_idx);
    let p = scene.tracks.position[at];
    Pose2::new(p.x, p.y, scene.tracks.heading_rad[at])
}
