//! Contacts at fault and expected contacts, as in nuPlan's closed-loop metrics.

use super::limits::{AHEAD_COS, STANDING_MPS};
use crate::geom::{OrientedBox, Point2, Real, Vector2};
use crate::scene::AgentKind;
use crate::state::{AgentStates, Footprint};

/// How far the rear axle lies behind the middle of a box, as a share of its length: 1.39 of the 4.08 m of nuScenes' car.
const REAR_AXLE_SHARE: Real = 0.34;
/// Steps of time at which boxes are looked at, seconds.
const GRID_S: Real = 0.1;

/// The middle of the rear axle of a body.
pub fn rear_axle(body: &OrientedBox) -> Point2 {
    body.centre - body.forward() * (REAR_AXLE_SHARE * 2.0 * body.half_length_m)
}

/// Cosine of the bearing of a place from the rear axle of a body.
pub(crate) fn bearing_cos(body: &OrientedBox, place: Point2) -> Real {
    let way = place - rear_axle(body);
    way.dot(&body.forward()) / way.norm().max(Real::MIN_POSITIVE)
}

pub(super) fn is_slower(velocity: Vector2, speed_mps: Real) -> bool {
    velocity.norm_squared() <= speed_mps * speed_mps
}

/// Whether a contact counts against an agent, by nuPlan's `no_ego_at_fault_collisions`. `stands`: whether it and the other
/// one drive at most [`STOPPED_MPS`](super::limits::STOPPED_MPS).
///
/// A stationary agent is never at fault. A moving agent is at fault if it hits a stationary one, or one that is not behind it
/// (more than 150 degrees off, seen from the rear axle) with its front edge. All other contacts, those of the sides, count
/// where the agent straddles lanes or is beside them.
pub(crate) fn is_at_fault(
    own: &OrientedBox,
    other: &OrientedBox,
    stands: [bool; 2],
    straddles: impl FnOnce() -> bool,
) -> bool {
    let is_hit_by_front = || {
        let centre = own.centre + own.forward() * own.half_length_m;
        OrientedBox { centre, half_length_m: 0.0, ..*own }.overlaps(other)
    };
    match stands {
        [true, _] => false,
        [false, true] => true,
        [false, false] => bearing_cos(own, other.centre) >= -AHEAD_COS && (is_hit_by_front() || straddles()),
    }
}

/// Time after which an agent touches another one when all go on along their headings at their speeds, seconds; `None`
/// where it does not within the horizon. It is nuPlan's `time_to_collision_within_bound`.
///
/// Boxes are checked every 0.1 s, beginning with the first. A standing agent has no contact; others have those with
/// agents ahead (within 30 degrees, seen from the rear axle) or, `from_sides`, in intersections and between lanes, with
/// all that are not behind. Others that it `ignores` do not count.
pub fn expected_contact_s(
    states: &AgentStates,
    footprints: &[Footprint],
    kinds: &[AgentKind],
    agent_idx: usize,
    from_sides: bool,
    ignores: impl Fn(usize) -> bool,
    horizon_s: Real,
) -> Option<Real> {
    let i = agent_idx;
    if is_slower(states.velocity(i), STANDING_MPS) {
        return None;
    }
    let steps = (horizon_s / GRID_S + 1e-3) as usize;
    let velocity = |a: usize| {
        let speed_mps = if kinds[a] == AgentKind::Static { 0.0 } else { states.velocity(a).norm() };
        Vector2::new(states.cos[a], states.sin[a]) * speed_mps
    };
    let least_cos = if from_sides { -AHEAD_COS } else { AHEAD_COS };
    let (own, own_velocity) = (states.oriented_box(i, &footprints[i]), velocity(i));
    let first_step = |j: usize| {
        let (other, other_velocity) = (states.oriented_box(j, &footprints[j]), velocity(j));
        let reach_m = footprints[i].radius_m + footprints[j].radius_m;
        let w = other_velocity - own_velocity;
        let far_m = reach_m + w.norm() * steps as Real * GRID_S;
        if (other.centre - own.centre).norm_squared() > far_m * far_m {
            return None;
        }
        (1..=steps).find(|k| {
            let time_s = *k as Real * GRID_S;
            let moved = |b: OrientedBox, v: Vector2| OrientedBox { centre: b.centre + v * time_s, ..b };
            moved(own, own_velocity).overlaps(&moved(other, other_velocity))
        })
    };
    (0..states.len())
        .filter(|j| *j != i && states.active[*j] && !ignores(*j) && states.same_level(i, *j))
        .filter(|j| bearing_cos(&own, states.position(*j)) > least_cos)
        .filter_map(first_step)
        .min()
        .map(|k| k as Real * GRID_S)
}
