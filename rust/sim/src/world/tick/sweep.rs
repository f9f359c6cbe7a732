//! States between two steps: steps longer than 0.1 s are checked in parts of at most that length, so that no agent
//! passes through another.

use crate::geom::{Pose2, Real, math};
use crate::state::AgentStates;

/// Longest time from one look to the next, seconds.
const PART_S: Real = 0.1;

/// Parts of a step.
#[inline]
pub(super) fn parts(dt_s: Real) -> usize {
    if dt_s <= PART_S {
        return 1;
    }
    (dt_s / PART_S - 1e-3).ceil().max(1.0) as usize
}

/// The pose at a share of the way from one to another.
pub(super) fn pose_between(from: &Pose2, to: &Pose2, share: Real) -> Pose2 {
    if share == 0.0 {
        return *from;
    }
    let turn = math::wrap_angle(to.heading_rad - from.heading_rad);
    let p = from.position + (to.position - from.position) * share;
    Pose2::new(p.x, p.y, from.heading_rad + turn * share)
}

/// States at a share of the way from the poses `before` a step; agents that were not there are left out.
pub(super) fn states_between(
    states: &AgentStates,
    before: &[Pose2],
    was_active: &[bool],
    share: Real,
) -> AgentStates {
    let mut between = states.clone();
    for (a, (from, was_active)) in before.iter().zip(was_active).enumerate() {
        between.active[a] &= was_active;
        if between.active[a] {
            between.set_pose(a, pose_between(from, &states.pose(a), share), states.velocity(a));
        }
    }
    between
}
