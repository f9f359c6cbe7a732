//! Trucks with trailers and buses of two boxes: which box tows which, and how the towed one follows.
//!
//! Two vehicles whose boxes overlap in line and that move together in the log are hitched. The box behind is towed: its
//! hitch goes with the leader, and its axle rolls towards the hitch at the distance that it has (a tractrix).

use crate::geom::{Point2, Pose2, Real, Vector2, math};
use crate::scene::{AgentKind, LEVEL_M, Scene};
use crate::state::Footprint;

/// Hitched boxes are logged together for this time at least, seconds, and move by this distance in it, metres.
const TOGETHER_S: Real = 1.0;
const MOVED_M: Real = 3.0;
/// Share of the common steps at which they overlap in line.
const MOST: Real = 0.8;
/// The distance of their centres varies by no more than this in these steps, metres: boxes of annotators jitter.
const PLAY_M: Real = 1.5;
/// The axle of a towed box is this share of its length behind its centre.
const AXLE: Real = 0.25;

/// Towed vehicles of a scene, each with the one that tows it; those nearer to the head of a chain come first.
pub fn hitches(scene: &Scene) -> Vec<(usize, usize)> {
    let moves = |a: &usize| {
        let mut points = (0..scene.num_steps)
            .filter(|t| scene.is_valid(*a, *t))
            .map(|t| scene.tracks.position[scene.at(*a, t)]);
        let first = points.next();
        scene.agents[*a].kind == AgentKind::Vehicle
            && first.is_some_and(|first| points.any(|p| (p - first).norm() >= MOVED_M))
    };
    let moving: Vec<usize> = (0..scene.num_agents()).filter(moves).collect();
    let mut left: Vec<(usize, usize)> = Vec::new();
    for &towed in &moving {
        let mut ahead = moving.iter().filter(|a| **a != towed && are_hitched(scene, **a, towed));
        left.extend(ahead.next().map(|leader| (towed, *leader)));
    }
    let mut pairs = Vec::with_capacity(left.len());
    // boxes are behind one another in line: there is no ring of them
    while let Some(k) = left.iter().position(|(_, leader)| left.iter().all(|(towed, _)| towed != leader)) {
        pairs.push(left.remove(k));
    }
    pairs
}

/// The chain of each of n agents, by its first vehicle; empty where none is towed.
pub(crate) fn chains(hitches: &[(usize, usize)], num_agents: usize) -> Vec<u32> {
    if hitches.is_empty() {
        return Vec::new();
    }
    let mut chains: Vec<u32> = (0..num_agents as u32).collect();
    hitches.iter().for_each(|(towed, leader)| chains[*towed] = chains[*leader]);
    chains
}

/// Whether one vehicle tows another one in the log.
fn are_hitched(scene: &Scene, leader: usize, towed: usize) -> bool {
    let common = || (0..scene.num_steps).filter(|t| scene.is_valid(leader, *t) && scene.is_valid(towed, *t));
    let size = |a: usize| (scene.agents[a].length_m, scene.agents[a].width_m);
    let ((length_a_m, width_a_m), (length_b_m, width_b_m)) = (size(leader), size(towed));
    let (own, other) = (Footprint::new(length_a_m, width_a_m), Footprint::new(length_b_m, width_b_m));
    let in_line = |t: usize| {
        let (a, b) = (scene.pose(leader, t), scene.pose(towed, t));
        let place = a.to_local(b.position);
        let height = |agent: usize| scene.tracks.elevation_m.get(scene.at(agent, t));
        let heights = height(leader).zip(height(towed));
        let level = heights.is_none_or(|(one, other)| (one - other).abs() <= LEVEL_M);
        let overlap = || level && own.at(&a).overlaps(&other.at(&b));
        place.x < -0.25 * (length_a_m + length_b_m) && a.cos * b.cos + a.sin * b.sin > 0.0 && overlap()
    };
    let (Some(first), Some(last)) = (common().next(), common().next_back()) else { return false };
    if !in_line(first) && !in_line(last) {
        return false;
    }
    let steps: Vec<usize> = common().filter(|t| in_line(*t)).collect();
    let moved = |a: usize| {
        let from = scene.pose(a, first).position;
        common().map(|t| (scene.pose(a, t).position - from).norm()).fold(0.0, Real::max)
    };
    let distances =
        || steps.iter().map(|t| (scene.pose(leader, *t).position - scene.pose(towed, *t).position).norm());
    let play_m = distances().fold(0.0, Real::max) - distances().fold(Real::INFINITY, Real::min);
    let least = MOST * common().count() as Real;
    steps.len() as Real >= least.max(TOGETHER_S / scene.dt_s)
        && play_m <= PLAY_M
        && moved(leader).min(moved(towed)) >= MOVED_M
}

/// Where a towed box goes when its leader goes from a pose to another one.
pub(crate) fn towed_pose(
    from: &Pose2,
    to: &Pose2,
    leader: &Footprint,
    pose: &Pose2,
    own: &Footprint,
) -> Pose2 {
    // the hitch: the middle of what the boxes share when in line
    let reach_m = 0.5 * (leader.half_length_m - own.half_length_m + (pose.position - from.position).norm());
    let hitch = Point2::new(-reach_m, 0.0);
    let axle_m = 2.0 * AXLE * own.half_length_m;
    let axle = pose.to_outer(Point2::new(-axle_m, 0.0));
    let before = from.to_outer(hitch) - axle;
    let hitch = to.to_outer(hitch);
    let after = hitch - axle;
    let (length_m, distance_m) = (before.norm(), after.norm());
    if length_m < 0.1 || distance_m < 0.1 {
        return *pose;
    }
    let axle = hitch - after * (length_m / distance_m);
    let turn = math::atan2(before.x * after.y - before.y * after.x, before.dot(&after));
    let heading_rad = pose.heading_rad + turn;
    let (sin, cos) = math::sin_cos(heading_rad);
    let centre = axle + Vector2::new(cos, sin) * axle_m;
    Pose2::new(centre.x, centre.y, heading_rad)
}
