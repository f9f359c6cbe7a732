//! Towed vehicles of a world: they follow the vehicle that they are hitched to, or the log where that one does.
//! An agent with a slot is never towed.

use crate::drivers::Driver;
use crate::geom::{Pose2, Real, Vector2};
use crate::stage::{PreparedScene, towed_pose};
use crate::world::episode::Episode;

/// Decides which vehicles are towed; those whose chain follows the log follow it, too.
pub(crate) fn find_towed(e: &mut Episode, scene: &PreparedScene) {
    for &(a, leader) in &scene.hitches {
        if e.has_slot(a) || (!e.states.active[leader] && e.drivers[a] == Driver::Towed) {
            continue;
        }
        let by_log = e.drivers[leader] == Driver::REPLAY && !e.has_slot(leader);
        e.drivers[a] = if by_log || !e.states.active[leader] { Driver::REPLAY } else { Driver::Towed };
    }
}

/// Removes towed vehicles whose leaders have left.
pub(super) fn leave(e: &mut Episode, scene: &PreparedScene) {
    for &(a, leader) in scene.hitches.iter().filter(|(a, _)| e.drivers[*a] == Driver::Towed) {
        e.states.active[a] &= e.states.active[leader];
    }
}

/// Moves towed vehicles behind their leaders, which have moved; `before` holds the poses before the step.
pub(super) fn tow(e: &mut Episode, scene: &PreparedScene, before: &[Pose2], dt_s: Real) {
    leave(e, scene);
    for &(a, leader) in &scene.hitches {
        if e.drivers[a] != Driver::Towed || !e.states.active[a] {
            continue;
        }
        let (own, other) = (&scene.footprints[a], &scene.footprints[leader]);
        let pose = towed_pose(&before[leader], &e.states.pose(leader), other, &before[a], own);
        e.set_pose(a, pose, behind(e, leader, &pose), dt_s);
    }
}

/// Velocity of a towed vehicle at a pose.
fn behind(e: &Episode, leader: usize, pose: &Pose2) -> Vector2 {
    let ahead = Vector2::new(pose.cos, pose.sin);
    ahead * e.states.velocity(leader).dot(&ahead)
}

/// Lets a towed vehicle in behind the one that tows it, as the log has it there.
pub(super) fn let_in(e: &mut Episode, scene: &PreparedScene, agent_idx: usize, dt_s: Real) {
    let leader = scene.hitches.iter().find(|(towed, _)| *towed == agent_idx).map(|(_, leader)| *leader);
    let leader = leader.filter(|leader| e.states.active[*leader] && !e.entered[agent_idx]);
    let Some((leader, (logged, _))) = leader.and_then(|l| Some((l, scene.log.at(l, e.step_idx)?))) else {
        return;
    };
    e.enter(scene, agent_idx, dt_s);
    let (place, here) = (e.states.pose(agent_idx), e.states.pose(leader));
    let position = here.to_outer(logged.to_local(place.position));
    let heading_rad = place.heading_rad + here.heading_rad - logged.heading_rad;
    let pose = Pose2::new(position.x, position.y, heading_rad);
    let velocity = behind(e, leader, &pose);
    e.states.set_pose(agent_idx, pose, velocity);
}
