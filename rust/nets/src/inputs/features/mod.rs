//! From a window of states to the network's inputs: one code for training and for the running world.
//!
//! Everything is agent-centric (reference.md#frames): for agent i the origin is its position at the current step and +x its
//! heading. Numbers are physical here; the network normalises them.

pub(crate) mod scene;
pub(crate) mod window;

pub use scene::{Futures, SceneFeatures, TokenInputs, row_offsets, vehicles};
pub use window::{Window, route_ahead};
use window::{distance_at, ttc_at};

use crate::config::{ModelConfig, NeighbourOrder};
use crate::error::Result;
use crate::inputs::segments::{self, MapLines};
use crate::inputs::unicycle;
use ccdiff_sim::causal::graph::{CausalGraph, GraphThresholds};
use ccdiff_sim::geom::{Pose2, Vector2};
use ccdiff_sim::scene::Scene;
use std::cmp::Ordering;

/// Numbers per history step: x, y, cos yaw, sin yaw, v, length, width, availability.
pub const HISTORY_FEATURES: usize = 8;
/// Numbers per edge and history step: relative x, y; cos, sin of the relative heading; relative velocity x, y;
/// relative distance of the bodies and time to contact, both 1 for "now" and 0 for 20 m or 20 s; availability.
pub const EDGE_FEATURES: usize = 9;
/// Samples of training start no earlier than this step, so that there is some history.
pub const FIRST_STEP: usize = 5;
/// Distance (m) and time to contact (s) at which their edge features reach zero.
const EDGE_RANGE: f32 = 20.0;
/// An agent this far beside one's body, metres, is still ahead in one's corridor.
const CORRIDOR_MARGIN_M: f32 = 1.0;
/// Headways are taken at this speed at least, metres per second, so that a standing agent sees one close ahead.
const HEADWAY_SPEED_MPS: f32 = 2.0;

/// Builds the inputs of one scene, from a window of the configuration's history and routes.
///
/// # Errors
/// As [`CausalGraph::from_measures`].
pub fn build(window: &Window, map: Option<&MapLines>, config: &ModelConfig) -> Result<SceneFeatures> {
    let now = window.num_steps - 1;
    let agents: Vec<usize> = (0..window.num_agents()).filter(|a| window.is_valid(*a, now)).collect();
    let poses: Vec<Pose2> = agents.iter().map(|a| window.pose(*a, now)).collect();
    let speed_mps = agents.iter().map(|a| window.speed_mps[a * window.num_steps + now]).collect();
    let history = histories(window, &agents, &poses);
    let ttc_now = ttc_at(window, &agents, now);
    let distance_m = distance_at(window, &agents, now);
    let graph_of = |times_s: &[f32]| graph_of_edges(times_s, &distance_m, agents.len(), config);
    let (graph, (num_slots, neighbours, is_edge)) = match config.neighbour_order {
        NeighbourOrder::Urgency => {
            let [seen_s, told_s] =
                [true, false].map(|oncoming| urgency(window, &agents, now, &ttc_now, config, oncoming));
            (graph_of(&told_s)?, slots(&graph_of(&seen_s)?, &seen_s, config.max_neighbours))
        }
        NeighbourOrder::Distance => {
            let graph = graph_of(&vec![0.0; distance_m.len()])?;
            let slots = slots(&graph, &distance_m, config.max_neighbours);
            (graph, slots)
        }
    };
    let token_steps = config.history_token_steps();
    let mut edges = vec![0.0; agents.len() * num_slots * token_steps.len() * EDGE_FEATURES];
    for (token, step) in token_steps.iter().enumerate() {
        let ttc = if *step == now { ttc_now.clone() } else { ttc_at(window, &agents, *step) };
        for row in 0..agents.len() {
            for slot in 0..num_slots {
                let other = neighbours[row * num_slots + slot];
                if slot > 0 && !is_edge[row * num_slots + slot] {
                    continue;
                }
                let at = ((row * num_slots + slot) * token_steps.len() + token) * EDGE_FEATURES;
                let ttc_s = ttc[row * agents.len() + other];
                if let Some(edge) = edge_at(window, (agents[row], agents[other]), *step, &poses[row], ttc_s) {
                    edges[at..at + EDGE_FEATURES].copy_from_slice(&edge);
                }
            }
        }
    }
    let mut features = SceneFeatures {
        noise_seed: agents.iter().map(|a| window.noise_seed.get(*a).copied()).collect(),
        route: routes(window, &agents, &poses, config.route_points_m.len()),
        agents,
        poses,
        speed_mps,
        history,
        num_slots,
        neighbours,
        is_edge,
        edges,
        segments: Vec::new(),
        graph,
        ttc_s: ttc_now,
        tokens: TokenInputs::default(),
    };
    if config.map.is_some() {
        features.segments = segments::seen(&features, map);
    }
    Ok(features)
}

fn histories(window: &Window, agents: &[usize], poses: &[Pose2]) -> Vec<f32> {
    let steps = window.num_steps;
    let mut history = vec![0.0; agents.len() * steps * HISTORY_FEATURES];
    for (row, (&agent, frame)) in agents.iter().zip(poses).enumerate() {
        for step in (0..steps).filter(|s| window.is_valid(agent, *s)) {
            let pose = window.pose(agent, step);
            let local = frame.to_local(pose.position);
            let turned = frame.rotate_inverse(Vector2::new(pose.cos, pose.sin));
            let speed = window.speed_mps[agent * steps + step];
            let at = (row * steps + step) * HISTORY_FEATURES;
            let (length, width) = (window.length_m[agent], window.width_m[agent]);
            history[at..at + HISTORY_FEATURES]
                .copy_from_slice(&[local.x, local.y, turned.x, turned.y, speed, length, width, 1.0]);
        }
    }
    history
}

/// See [`SceneFeatures::route`].
fn routes(window: &Window, agents: &[usize], poses: &[Pose2], num_points: usize) -> Vec<f32> {
    let width = if num_points == 0 { 0 } else { 1 + 2 * num_points };
    let mut out = vec![0.0; agents.len() * width];
    for ((agent, frame), row) in agents.iter().zip(poses).zip(out.chunks_exact_mut(width.max(1))) {
        let Some(points) = window.routes.get(*agent).filter(|points| !points.is_empty()) else { continue };
        row[0] = 1.0;
        for (place, point) in row[1..].chunks_exact_mut(2).zip(points) {
            let local = frame.to_local(*point);
            place.copy_from_slice(&[local.x, local.y]);
        }
    }
    out
}

/// The graph of M agents by times and distances [M, M].
fn graph_of_edges(
    times_s: &[f32],
    distance_m: &[f32],
    m: usize,
    config: &ModelConfig,
) -> Result<CausalGraph> {
    let thresholds =
        GraphThresholds { ttc_s: config.ttc_threshold_s, distance_m: config.distance_threshold_m };
    Ok(CausalGraph::from_measures(m, times_s, distance_m, thresholds)?)
}

/// Times by which pairs are joined and sorted, [M, M]: the time to contact, or less for an agent ahead in one's corridor.
///
/// Differs from the paper: with [`ModelConfig::headway_threshold_s`] above 0, i is also joined with j where j is ahead
/// in its corridor and i needs at most so long to where j's rear is now. By time to contact alone a car that follows at
/// equal speed does not see its leader. With `oncoming`, as the networks were trained, those that come towards i count as
/// well, whose time to contact says whether they ever touch it.
fn urgency(
    window: &Window,
    agents: &[usize],
    step: usize,
    ttc_s: &[f32],
    config: &ModelConfig,
    oncoming: bool,
) -> Vec<f32> {
    let (m, limit_s) = (agents.len(), config.headway_threshold_s);
    let mut edge_time_s = ttc_s.to_vec();
    if limit_s <= 0.0 {
        return edge_time_s;
    }
    for (i, j) in (0..m * m).map(|k| (k / m, k % m)).filter(|(i, j)| i != j) {
        let (headway_s, cos) = headway_s(window, (agents[i], agents[j]), step);
        if headway_s <= limit_s && (oncoming || cos > 0.0) {
            let entry = &mut edge_time_s[i * m + j];
            *entry = entry.min(headway_s * (config.ttc_threshold_s / limit_s).min(1.0));
        }
    }
    edge_time_s
}

/// Time i needs to where the rear of j is now, seconds; infinite where j is not ahead in i's corridor, which is i's
/// width and [`CORRIDOR_MARGIN_M`] on either side, straight on; and the cosine of j's heading in i's.
fn headway_s(window: &Window, (i, j): (usize, usize), step: usize) -> (f32, f32) {
    let (pose_i, pose_j) = (window.pose(i, step), window.pose(j, step));
    let offset = pose_i.to_local(pose_j.position);
    let heading = pose_i.rotate_inverse(Vector2::new(pose_j.cos, pose_j.sin));
    let (cos, sin) = (heading.x.abs(), heading.y.abs());
    let half_length = 0.5 * (window.length_m[i] + cos * window.length_m[j] + sin * window.width_m[j]);
    let half_width = 0.5 * (window.width_m[i] + sin * window.length_m[j] + cos * window.width_m[j]);
    if offset.x <= 0.0 || offset.y.abs() > half_width + CORRIDOR_MARGIN_M || window.is_apart(i, j) {
        return (f32::INFINITY, heading.x);
    }
    let speed = window.speed_mps[i * window.num_steps + step];
    ((offset.x - half_length).max(0.0) / speed.max(HEADWAY_SPEED_MPS), heading.x)
}

/// Slot table of a graph: itself, then the joined agents in rising `order` [M, M].
fn slots(graph: &CausalGraph, order: &[f32], max_neighbours: usize) -> (usize, Vec<usize>, Vec<bool>) {
    let m = graph.num_agents();
    let lists: Vec<Vec<usize>> = (0..m)
        .map(|i| {
            let mut list: Vec<usize> = (0..m).filter(|j| *j != i && graph.contains(i, *j)).collect();
            list.sort_by(|a, b| {
                let of = |j: &usize| order[i * m + *j];
                of(a).partial_cmp(&of(b)).unwrap_or(Ordering::Equal).then(a.cmp(b))
            });
            list.truncate(max_neighbours);
            list
        })
        .collect();
    let num_slots = 1 + lists.iter().map(Vec::len).max().unwrap_or(0);
    let mut neighbours = Vec::with_capacity(m * num_slots);
    let mut is_edge = Vec::with_capacity(m * num_slots);
    for (i, list) in lists.iter().enumerate() {
        neighbours.push(i);
        is_edge.push(false);
        for slot in 0..num_slots - 1 {
            neighbours.push(list.get(slot).copied().unwrap_or(i));
            is_edge.push(slot < list.len());
        }
    }
    (num_slots, neighbours, is_edge)
}

/// Edge of agents (i, j) at a step in i's frame of now; `None` where either was not there.
///
/// Differs from the released code (reference.md#pairwise-features): position and velocity are those of j relative to i at the same step,
/// in physical units.
fn edge_at(
    window: &Window,
    (i, j): (usize, usize),
    step: usize,
    frame: &Pose2,
    ttc_s: f32,
) -> Option<[f32; EDGE_FEATURES]> {
    if !(window.is_valid(i, step) && window.is_valid(j, step)) {
        return None;
    }
    let (pose_i, pose_j) = (window.pose(i, step), window.pose(j, step));
    let offset = frame.rotate_inverse(pose_j.position - pose_i.position);
    let heading = frame.rotate_inverse(Vector2::new(pose_j.cos, pose_j.sin));
    let velocity = frame.rotate_inverse(window.velocity(j, step) - window.velocity(i, step));
    let half_sizes = 0.25 * (window.length_m[i] + window.width_m[i] + window.length_m[j] + window.width_m[j]);
    let nearness = |v: f32| (EDGE_RANGE - v.clamp(0.0, EDGE_RANGE)) / EDGE_RANGE;
    let gap = nearness(offset.norm() - half_sizes);
    let ttc_s = if i == j || ttc_s.is_nan() { 0.0 } else { ttc_s };
    Some([offset.x, offset.y, heading.x, heading.y, velocity.x, velocity.y, gap, nearness(ttc_s), 1.0])
}

/// Logged futures of window agents in their frames at the current step.
///
/// `agents` maps window rows to agents of the scene; `step_idx` is the current step. `adapt` may move a pose, given its
/// window row and the steps since now.
pub fn futures(
    scene: &Scene,
    step_idx: usize,
    agents: &[usize],
    features: &SceneFeatures,
    config: &ModelConfig,
    adapt: impl Fn(usize, usize, Pose2) -> Pose2,
) -> Futures {
    let steps = config.horizon_steps;
    let mut out = Futures { states: Vec::new(), valid: Vec::new() };
    for (row, frame) in features.poses.iter().enumerate() {
        let agent = agents[features.agents[row]];
        let mut poses = Vec::with_capacity(steps);
        for step in step_idx + 1..=step_idx + steps {
            if !scene.is_valid(agent, step) {
                break;
            }
            let pose = adapt(features.agents[row], step - step_idx, scene.pose(agent, step));
            let local = frame.to_local(pose.position);
            poses.push([local.x, local.y, pose.heading_rad - frame.heading_rad]);
        }
        let states = unicycle::states_of_poses(&poses, features.speed_mps[row], config.dt_s as f32);
        out.states.extend(states.iter().flatten());
        out.states.resize(out.states.len() + (steps - states.len()) * 6, 0.0);
        out.valid.extend((0..steps).map(|t| t < states.len()));
    }
    out
}

#[cfg(test)]
mod tests;
