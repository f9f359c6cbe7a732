//! Time to contact of the agents of a world.

use crate::geom::Real;
use crate::simd_dispatch::simd_dispatch;
use crate::state::{AgentStates, Body};

/// Agents asked about at once.
const LANES: usize = 8;

/// Finds the least time to contact of one agent after the other; holds the memory that it works in.
#[derive(Debug, Clone, Default)]
pub struct LeastTimes {
    /// Radii of the circles round the boxes; negative without end for agents that are not there.
    radius_m: Vec<Real>,
    /// 1 for agents that may be met; whole blocks.
    may_meet: Vec<u8>,
}

impl LeastTimes {
    /// Takes what all questions about a step have in common.
    pub fn prepare(&mut self, states: &AgentStates, bodies: &[Body]) {
        self.radius_m.clear();
        self.radius_m.extend(
            bodies.iter().zip(&states.active).map(
                |(body, active)| {
                    if *active { body.radius_m } else { Real::NEG_INFINITY }
                },
            ),
        );
    }

    /// First time at which an agent touches any other when all keep their velocities, seconds, at most the horizon.
    pub fn of(&mut self, states: &AgentStates, bodies: &[Body], agent_idx: usize, horizon_s: Real) -> Real {
        let num_agents = states.len();
        self.may_meet.resize(num_agents.next_multiple_of(LANES), 0);
        self.may_meet[num_agents..].fill(0);
        circles_may_meet(
            states,
            &self.radius_m,
            bodies[agent_idx].radius_m,
            agent_idx,
            horizon_s,
            &mut self.may_meet[..num_agents],
        );
        self.may_meet[agent_idx] = 0;
        let mut least_s = horizon_s;
        for (block, may_meet) in self.may_meet.as_chunks::<LANES>().0.iter().enumerate() {
            let mut left = u64::from_le_bytes(*may_meet);
            while left != 0 {
                let other = block * LANES + left.trailing_zeros() as usize / 8;
                least_s = time_to_contact(states, bodies, agent_idx, other, least_s).unwrap_or(least_s);
                left &= left - 1;
            }
        }
        least_s
    }
}

simd_dispatch! {
    /// Which agents' circles touch the one of an agent within the horizon; true also where that is not sure.
    fn circles_may_meet(
        states: &AgentStates,
        radius_m: &[Real],
        own_radius_m: Real,
        agent_idx: usize,
        horizon_s: Real,
        may_meet: &mut [u8],
    ) {
        let (x, y) = (states.x[agent_idx], states.y[agent_idx]);
        let (vx, vy) = (states.velocity_x_mps[agent_idx], states.velocity_y_mps[agent_idx]);
        let n = may_meet.len();
        let (xs, ys, radius_m) = (&states.x[..n], &states.y[..n], &radius_m[..n]);
        let (vxs, vys) = (&states.velocity_x_mps[..n], &states.velocity_y_mps[..n]);
        for j in 0..n {
            let (dx, dy) = (xs[j] - x, ys[j] - y);
            let (wx, wy) = (vxs[j] - vx, vys[j] - vy);
            let reach = radius_m[j] + own_radius_m;
            let (dw, ww) = (dx * wx + dy * wy, wx * wx + wy * wy);
            let gap = dx * dx + dy * dy - reach * reach;
            // the circles touch when |d + w t| = reach: at t = (−dw − √(dw² − ww gap)) / ww
            let discriminant = dw * dw - ww * gap;
            let late = -dw - discriminant.sqrt() > horizon_s * ww;
            let apart = (gap > 0.0) & ((dw >= 0.0) | (discriminant < 0.0) | late);
            may_meet[j] = u8::from(!apart & (reach >= 0.0));
        }
    }
}

/// First time at which two agents touch when both keep their velocities, seconds; `None` beyond the horizon.
///
/// The circles round the boxes are asked first: most pairs never come near.
#[inline]
pub fn time_to_contact(
    states: &AgentStates,
    bodies: &[Body],
    i: usize,
    j: usize,
    horizon_s: Real,
) -> Option<Real> {
    let d = states.position(j) - states.position(i);
    let w = states.velocity(j) - states.velocity(i);
    let reach = bodies[i].radius_m + bodies[j].radius_m;
    // the circles touch when |d + w t| = reach
    let (dw, ww) = (d.dot(&w), w.norm_squared());
    let gap = d.norm_squared() - reach * reach;
    if gap > 0.0 {
        let discriminant = dw * dw - ww * gap;
        if dw >= 0.0 || discriminant < 0.0 || -dw - discriminant.sqrt() > horizon_s * ww {
            return None;
        }
    }
    let (a, b) = (states.oriented_box(i, &bodies[i]), states.oriented_box(j, &bodies[j]));
    a.time_to_contact(states.velocity(i), &b, states.velocity(j), horizon_s)
}
