//! Pictures of a scene's log: what stands where at a step, trails and the ego's route.

use crate::palette::Driver;
use crate::picture::AgentBox;
use ccdiff_sim::geom::{Point2, Pose2};
use ccdiff_sim::scene::{EGO_ID, Scene};

/// Boxes of the agents logged at a step: the ego as [`Driver::Ego`], all others as [`Driver::Replay`]. None past
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
            }
        })
        .collect()
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

/// [`Driver::Ego`] or [`Driver::Replay`].
pub fn driver_of(scene: &Scene, agent_idx: usize) -> Driver {
    if scene.agents[agent_idx].id == EGO_ID { Driver::Ego } else { Driver::Replay }
}

fn logged_pose(scene: &Scene, agent_idx: usize, step_idx: usize) -> Pose2 {
    let at = scene.at(agent_idx, step_idx);
    let p = scene.tracks.position[at];
    Pose2::new(p.x, p.y, scene.tracks.heading_rad[at])
}
