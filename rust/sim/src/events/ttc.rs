//! Time to contact of the agents of a world.

use crate::geom::Real;
use crate::simd_dispatch::simd_dispatch;
use crate::state::{AgentStates, Footprint};

/// Agents asked about at once.
const LANES: usize = 8;

/// Finds the least times to contact of some agents; holds the memory that it works in.
#[derive(Debug, Clone, Default)]
pub struct LeastTimes {
    /// Radii of the circles round the boxes; negative without end for agents that are not there, or were asked about.
    radius_m: Vec<Real>,
    /// 1 for agents that may be met; whole blocks.
    may_meet: Vec<u8>,
    /// Least time of each agent that is asked about, seconds; 0 for the others.
    least_s: Vec<Real>,
}

impl LeastTimes {
    /// Finds the first time at which each of some agents touches any other when all keep their velocities, seconds, at
    /// most the horizon. Each pair is looked at once.
    pub fn find(
        &mut self,
        states: &AgentStates,
        footprints: &[Footprint],
        agents: impl Iterator<Item = usize> + Clone,
        horizon_s: Real,
    ) {
        let radius_m = |(footprint, there): (&Footprint, &bool)| {
            if *there { footprint.radius_m } else { Real::NEG_INFINITY }
        };
        self.radius_m.clear();
        self.radius_m.extend(footprints.iter().zip(&states.active).map(radius_m));
        self.may_meet.resize(states.len().next_multiple_of(LANES), 0);
        self.least_s.clear();
        self.least_s.resize(states.len(), 0.0);
        agents.clone().for_each(|a| self.least_s[a] = horizon_s);
        // who is not there would meet the others, but they do not meet it
        for a in agents.clone().filter(|a| !states.active[*a]) {
            self.measure(states, footprints, a, 0, horizon_s);
        }
        let mut first = 0;
        for a in agents.filter(|a| states.active[*a]) {
            first += self.radius_m[first..].iter().take_while(|r| **r < 0.0).count();
            self.measure(states, footprints, a, first, horizon_s);
            self.radius_m[a] = Real::NEG_INFINITY;
        }
    }

    /// The time of one of the agents.
    pub fn of(&self, agent_idx: usize) -> Real {
        self.least_s[agent_idx]
    }

    /// Looks at an agent with all that are left, from the first of them on.
    fn measure(
        &mut self,
        states: &AgentStates,
        footprints: &[Footprint],
        agent_idx: usize,
        first: usize,
        horizon_s: Real,
    ) {
        let num_agents = states.len();
        let first = first / LANES * LANES;
        self.may_meet[num_agents..].fill(0);
        let own_radius_m = footprints[agent_idx].radius_m;
        let may_meet = &mut self.may_meet[first..num_agents];
        circles_may_meet(states, &self.radius_m, own_radius_m, agent_idx, first, horizon_s, may_meet);
        self.may_meet[agent_idx] = 0;
        let is_there = states.active[agent_idx];
        for (block, may_meet) in self.may_meet[first..].as_chunks::<LANES>().0.iter().enumerate() {
            let mut left = u64::from_le_bytes(*may_meet);
            while left != 0 {
                let other = first + block * LANES + left.trailing_zeros() as usize / 8;
                left &= left - 1;
                let least_s = if is_there { self.least_s[other] } else { 0.0 };
                let within_s = self.least_s[agent_idx].max(least_s);
                if let Some(time_s) = time_to_contact(states, footprints, agent_idx, other, within_s) {
                    self.least_s[agent_idx] = self.least_s[agent_idx].min(time_s);
                    if is_there {
                        self.least_s[other] = least_s.min(time_s);
                    }
                }
            }
        }
    }
}

simd_dispatch! {
    /// Which agents' circles, from the first one on, touch the one of an agent within the horizon; true also where that
    /// is not sure.
    fn circles_may_meet(
        states: &AgentStates,
        radius_m: &[Real],
        own_radius_m: Real,
        agent_idx: usize,
        first: usize,
        horizon_s: Real,
        may_meet: &mut [u8],
    ) {
        let (x, y) = (states.x[agent_idx], states.y[agent_idx]);
        let (vx, vy) = (states.velocity_x_mps[agent_idx], states.velocity_y_mps[agent_idx]);
        let n = may_meet.len();
        let (xs, ys, radius_m) = (&states.x[first..][..n], &states.y[first..][..n], &radius_m[first..][..n]);
        let (vxs, vys) = (&states.velocity_x_mps[first..][..n], &states.velocity_y_mps[first..][..n]);
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
    footprints: &[Footprint],
    i: usize,
    j: usize,
    horizon_s: Real,
) -> Option<Real> {
    let d = states.position(j) - states.position(i);
    let w = states.velocity(j) - states.velocity(i);
    let reach = footprints[i].radius_m + footprints[j].radius_m;
    // the circles touch when |d + w t| = reach
    let (dw, ww) = (d.dot(&w), w.norm_squared());
    let gap = d.norm_squared() - reach * reach;
    if gap > 0.0 {
        let discriminant = dw * dw - ww * gap;
        if dw >= 0.0 || discriminant < 0.0 || -dw - discriminant.sqrt() > horizon_s * ww {
            return None;
        }
    }
    let (a, b) = (states.oriented_box(i, &footprints[i]), states.oriented_box(j, &footprints[j]));
    a.time_to_contact(states.velocity(i), &b, states.velocity(j), horizon_s)
}
