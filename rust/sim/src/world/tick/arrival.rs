//! Agents that enter a world after its start: late arrivals, and agents that the log has again after a gap.
//!
//! An agent that follows its log is there whenever the log has it, also where logged boxes overlap. It waits only where
//! its body would appear inside an agent that is not at its own logged place, such as a driven ego. After a gap no longer
//! than loaders fill it does not wait. Agents with other drivers enter once, by the same rule.

use crate::drivers::Driver;
use crate::geom::Real;
use crate::scene::{AgentKind, LEVEL_M, LONGEST_GAP_S};
use crate::stage::PreparedScene;
use crate::world::config::WorldConfig;
use crate::world::episode::Episode;
use crate::world::tick::tow;

/// Agents nearer to their logged place are at it, metres.
const AT_LOG_M: Real = 0.01;

/// Lets in the agents that are logged at the present step and may enter. Contacts in which one appears are given.
pub(super) fn let_in(e: &mut Episode, scene: &PreparedScene, config: &WorldConfig) {
    for a in 0..e.states.len() {
        if e.states.active[a] || !scene.log.has(a, e.step_idx) {
            continue;
        }
        if e.drivers[a] == Driver::Towed {
            tow::let_in(e, scene, a, config.dt_s);
            continue;
        }
        let comes_back = e.drivers[a] == Driver::REPLAY && !e.halted[a] && !e.has_slot(a);
        if e.entered[a]
            && comes_back
            && scene.log.has_again(a, e.step_idx, (LONGEST_GAP_S / config.dt_s) as usize)
        {
            e.enter(scene, a, config.dt_s);
        } else if if e.entered[a] { comes_back } else { config.late_arrivals } && place_is_free(e, scene, a) {
            e.enter(scene, a, config.dt_s);
            for j in (0..e.states.len()).filter(|j| *j != a) {
                if e.states.active[j] && overlaps(e, scene, a, j) {
                    e.given_contacts.push((a.min(j) as u32, a.max(j) as u32));
                    for (slot, other) in [(a, j), (j, a)] {
                        if e.has_slot(slot) || e.drivers[slot] == Driver::Towed {
                            e.initial_contacts.push((slot as u32, other as u32));
                        }
                    }
                }
            }
        }
    }
}

/// Whether the box of an agent at its logged place overlaps that of another one of its level where it is.
fn overlaps(e: &Episode, scene: &PreparedScene, a: usize, j: usize) -> bool {
    let Some((pose, _)) = scene.log.at(a, e.step_idx) else { return false };
    let heights = scene.log.height(a, e.step_idx).zip(e.states.elevation_m(j));
    let is_apart = heights.is_some_and(|(own, other)| (own.elevation_m - other).abs() > LEVEL_M);
    let reach_m = scene.footprints[j].radius_m + scene.footprints[a].radius_m;
    !is_apart
        && (e.states.position(j) - pose.position).norm_squared() <= reach_m * reach_m
        && scene.footprints[a].at(&pose).overlaps(&e.states.oriented_box(j, &scene.footprints[j]))
}

/// Whether the logged place of an agent is free of agents that are not there by the log.
fn place_is_free(e: &Episode, scene: &PreparedScene, a: usize) -> bool {
    let by_log = |j: usize| {
        let logged = scene.log.position(j, e.step_idx);
        scene.kinds[j] == AgentKind::Static
            || logged.is_some_and(|p| (e.states.position(j) - p).norm() <= AT_LOG_M)
    };
    (0..e.states.len()).all(|j| !e.states.active[j] || !overlaps(e, scene, a, j) || by_log(j))
}
