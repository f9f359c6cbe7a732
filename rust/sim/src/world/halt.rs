//! Background agents that touch stop where they touch, and stay there.

use crate::events::Collisions;
use crate::geom::{Pose2, math};
use crate::policy::Driver;
use crate::scene::AgentKind;
use crate::stage::PreparedScene;
use crate::world::episode::Episode;

/// Halvings in the search for the moment of contact: 1/32 of a step, 5 cm at 16 m/s.
const HALVINGS: usize = 5;

/// Whether a vehicle without a slot is driven by another policy than its log.
fn is_driven(e: &Episode, a: usize) -> bool {
    matches!(e.drivers[a], Driver::Policy(_)) && e.drivers[a] != Driver::REPLAY && !e.has_slot(a)
}

/// Takes the contacts at the start of an episode as given.
pub(super) fn begin(e: &mut Episode, scene: &PreparedScene, collisions: &mut Collisions) {
    e.halted.clear();
    e.halted.resize(e.states.len(), false);
    e.given_contacts.clear();
    if (0..e.states.len()).any(|a| is_driven(e, a)) {
        collisions.find(&e.states, &scene.footprints, &scene.kinds);
        e.given_contacts.extend_from_slice(collisions.pairs());
    }
}

/// Stops the background agents of contacts that begin in a step and that a driven vehicle takes part in. They are put
/// back to the moment of the contact; their velocity is that of the step, zero from the next one on. `before` holds
/// the poses before the step.
pub(super) fn halt(e: &mut Episode, scene: &PreparedScene, collisions: &mut Collisions, before: &[Pose2]) {
    collisions.find(&e.states, &scene.footprints, &scene.kinds);
    let pairs = collisions.pairs();
    let gone = |a: u32| !e.states.active[a as usize];
    e.given_contacts.retain(|pair| pairs.contains(pair) || gone(pair.0) || gone(pair.1));
    for (i, j) in pairs {
        let ends = [*i as usize, *j as usize];
        if e.given_contacts.contains(&(*i, *j)) || !ends.iter().any(|a| is_driven(e, *a)) {
            continue;
        }
        for (a, other) in [(ends[0], ends[1]), (ends[1], ends[0])] {
            let moves = scene.kinds[a] != AgentKind::Static && e.drivers[a] != Driver::External;
            if moves && !e.has_slot(a) && !e.halted[a] {
                e.halted[a] = true;
                let velocity = e.states.velocity(a);
                let pose = at_contact(e, scene, a, other, &before[a]);
                e.states.set_pose(a, pose, velocity);
            }
        }
    }
}

/// The first pose on the way of a step that overlaps another agent, up to a part of the step.
fn at_contact(e: &Episode, scene: &PreparedScene, a: usize, other: usize, from: &Pose2) -> Pose2 {
    let to = e.states.pose(a);
    let turn = math::wrap_angle(to.heading_rad - from.heading_rad);
    let at = |f: f32| {
        let p = from.position + (to.position - from.position) * f;
        Pose2::new(p.x, p.y, from.heading_rad + turn * f)
    };
    let obstacle = e.states.oriented_box(other, &scene.footprints[other]);
    let overlaps = |f: f32| scene.footprints[a].at(&at(f)).overlaps(&obstacle);
    if overlaps(0.0) {
        return *from;
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
    at(in_contact)
}
