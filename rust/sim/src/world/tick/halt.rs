//! Background agents that touch stop where they touch, and stay there.

use crate::drivers::Driver;
use crate::events::Collisions;
use crate::geom::{Pose2, Real};
use crate::scene::AgentKind;
use crate::stage::PreparedScene;
use crate::world::episode::Episode;
use crate::world::tick::sweep::{parts, pose_between, states_between};

/// Halvings in the search for the moment of contact: 1/32 of a step, 5 cm at 16 m/s.
const HALVINGS: usize = 5;

/// Whether a vehicle without a slot has another driver than its log.
fn is_driven(e: &Episode, a: usize) -> bool {
    !matches!(e.drivers[a], Driver::External | Driver::REPLAY) && !e.has_slot(a)
}

/// Records the contacts at the start of an episode, which are ignored until they end.
pub(super) fn begin(e: &mut Episode, scene: &PreparedScene, collisions: &mut Collisions) {
    e.halted.clear();
    e.halted.resize(e.states.len(), false);
    e.given_contacts.clear();
    if (0..e.states.len()).any(|a| is_driven(e, a)) {
        collisions.find(&e.states, &scene.footprints, &scene.kinds);
        e.given_contacts.extend_from_slice(collisions.pairs());
    }
}

/// Puts agents in new contacts with driven vehicles back to the moment of contact; they are halted from the next step on.
pub(super) fn halt(
    e: &mut Episode,
    scene: &PreparedScene,
    collisions: &mut Collisions,
    (before, was_active): (&[Pose2], &[bool]),
    dt_s: Real,
) {
    let parts = parts(dt_s);
    for part in 1..=parts {
        let share = part as Real / parts as Real;
        let between = (part < parts).then(|| states_between(&e.states, before, was_active, share));
        collisions.find(between.as_ref().unwrap_or(&e.states), &scene.footprints, &scene.kinds);
        let pairs = collisions.pairs();
        if part == parts {
            let gone = |a: u32| !e.states.active[a as usize];
            e.given_contacts.retain(|pair| pairs.binary_search(pair).is_ok() || gone(pair.0) || gone(pair.1));
        }
        let mut given_idx = 0; // given contacts are in the order of the pairs, but those of late arrivals
        for pair in pairs {
            let ends = [pair.0 as usize, pair.1 as usize];
            given_idx += e.given_contacts[given_idx..].iter().take_while(|given| *given < pair).count();
            if e.given_contacts.get(given_idx) == Some(pair)
                || !ends.iter().any(|a| is_driven(e, *a))
                || !ends.iter().any(|a| may_stop(e, scene, *a))
                || e.given_contacts.contains(pair)
            {
                continue;
            }
            for (a, other) in [(ends[0], ends[1]), (ends[1], ends[0])] {
                if may_stop(e, scene, a) {
                    let last = || share_at_contact(e, scene, a, other, &before[a]);
                    let share = if part == parts { last() } else { share };
                    stop(e, scene, a, before, share);
                }
            }
        }
    }
}

/// Stops an agent and all hitched to it at a share of their way.
fn stop(e: &mut Episode, scene: &PreparedScene, a: usize, before: &[Pose2], share: Real) {
    for b in 0..e.states.len() {
        if (b == a || e.states.hitched(a, b)) && may_stop(e, scene, b) {
            e.halted[b] = true;
            let velocity = e.states.velocity(b);
            let pose = pose_between(&before[b], &e.states.pose(b), share);
            e.states.set_pose(b, pose, velocity);
        }
    }
}

fn may_stop(e: &Episode, scene: &PreparedScene, a: usize) -> bool {
    let moves = scene.kinds[a] != AgentKind::Static && e.drivers[a] != Driver::External;
    moves && e.states.active[a] && !e.has_slot(a) && !e.halted[a]
}

/// The share of an agent's way in a step at which it first overlaps another one, up to a part of the step.
fn share_at_contact(e: &Episode, scene: &PreparedScene, a: usize, other: usize, from: &Pose2) -> Real {
    let to = e.states.pose(a);
    let obstacle = e.states.oriented_box(other, &scene.footprints[other]);
    let overlaps = |share| scene.footprints[a].at(&pose_between(from, &to, share)).overlaps(&obstacle);
    if overlaps(0.0) {
        return 0.0;
    }
    let (mut free, mut in_contact) = (0.0, 1.0);
    for _ in 0..HALVINGS {
        let middle = 0.5 * (free + in_contact);
        if overlaps(middle) {
            in_contact = middle;
        } else {
            free = middle;
        }
    }
    in_contact
}
