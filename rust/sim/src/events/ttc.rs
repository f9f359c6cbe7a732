//! Time to contact of the agents of a world.

use crate::geom::Real;
use crate::simd_dispatch::simd_dispatch;
use crate::state::{AgentStates, Footprint};

/// Agents asked about at once.
const LANES: usize = 8;
/// So many agents that are asked about are many.
const MANY: usize = 4;
/// Relative differences that rounding could make are left to [`time_to_contact`].
const UNSURE: Real = 1e-3;

/// x, y, velocity x and y of agents, and the radii of the circles round their boxes.
const NUM_COLUMNS: usize = 5;

/// Finds the least times to contact of some agents; holds the memory that it works in.
#[derive(Debug, Clone, Default)]
pub struct LeastTimes {
    /// Agents that are asked about; where they are many, then those others that are there.
    agents: Vec<u32>,
    /// Their numbers, then those of the others; whole blocks, padded by agents that never meet any.
    columns: [Vec<Real>; NUM_COLUMNS],
    /// 1 for agents that may be met.
    may_meet: Vec<[u8; LANES]>,
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
        self.least_s.clear();
        self.least_s.resize(states.len(), 0.0);
        agents.clone().for_each(|a| self.least_s[a] = horizon_s);
        self.agents.clear();
        self.agents.extend(agents.clone().filter(|a| states.active[*a]).map(|a| a as u32));
        let num_asked = self.agents.len();
        let may_be_met = |(active, least_s): (&bool, &Real)| active & (*least_s == 0.0);
        let may_be_met = states.active.iter().zip(&self.least_s).map(may_be_met);
        // to leave out the others pays where many are asked about
        let leaves_out = num_asked >= MANY;
        if leaves_out {
            let others = (0u32..).zip(may_be_met.clone());
            self.agents.extend(others.filter(|(_, may)| *may).map(|(a, _)| a));
        }
        let gathered = &self.agents;
        let of_states =
            [&states.x, &states.y, &states.velocity_x_mps, &states.velocity_y_mps].map(Vec::as_slice);
        let num_others = if leaves_out { 0 } else { states.len() };
        let num_padded = (gathered.len() + num_others).next_multiple_of(LANES);
        let [columns @ .., radii] = &mut self.columns;
        for (column, of_states) in columns.iter_mut().zip(of_states) {
            column.clear();
            column.extend(gathered.iter().map(|a| of_states[*a as usize]));
            column.extend_from_slice(if leaves_out { &[] } else { of_states });
            column.resize(num_padded, 0.0);
        }
        radii.clear();
        radii.extend(gathered.iter().map(|a| footprints[*a as usize].radius_m));
        if !leaves_out {
            let radius_m = |(f, may): (&Footprint, bool)| if may { f.radius_m } else { Real::NEG_INFINITY };
            radii.extend(footprints.iter().zip(may_be_met).map(radius_m));
        }
        radii.resize(num_padded, Real::NEG_INFINITY);
        self.may_meet.resize(num_padded / LANES, [0; LANES]);
        // absent agents are measured against the others, not the others against them
        for a in agents.filter(|a| !states.active[*a]) {
            for other in (0..states.len()).filter(|other| states.active[*other]) {
                let time_s = time_to_contact(states, footprints, a, other, self.least_s[a]);
                self.least_s[a] = time_s.map_or(self.least_s[a], |time_s| time_s.min(self.least_s[a]));
            }
        }
        for rank in 0..num_asked {
            self.measure(states, footprints, rank, num_asked, horizon_s);
        }
    }

    /// The time of one of the agents.
    pub fn of(&self, agent_idx: usize) -> Real {
        self.least_s[agent_idx]
    }

    /// Looks at the agent of a rank with all that follow it in the list, or with all agents by index.
    fn measure(
        &mut self,
        states: &AgentStates,
        footprints: &[Footprint],
        rank: usize,
        num_asked: usize,
        horizon_s: Real,
    ) {
        let own = std::array::from_fn(|column| self.columns[column][rank]);
        let (block, before) = ((rank + 1) / LANES, (rank + 1) % LANES);
        let columns = self.columns.each_ref().map(|column| &column[(block * LANES).min(column.len())..]);
        let may_meet = &mut self.may_meet[block..];
        circles_may_meet(own, &columns, horizon_s, may_meet);
        if let Some(first) = may_meet.first_mut() {
            first[..before].fill(0);
        }
        let agent_idx = self.agents[rank] as usize;
        for (k, may_meet) in may_meet.iter().enumerate() {
            let mut left = u64::from_le_bytes(*may_meet);
            while left != 0 {
                let at = (block + k) * LANES + left.trailing_zeros() as usize / 8;
                let other = self.agents.get(at).map_or_else(|| at - num_asked, |a| *a as usize);
                left &= left - 1;
                let (own_s, other_s) = (self.least_s[agent_idx], self.least_s[other]);
                if let Some(time_s) =
                    time_to_contact(states, footprints, agent_idx, other, own_s.max(other_s))
                {
                    self.least_s[agent_idx] = own_s.min(time_s);
                    self.least_s[other] = other_s.min(time_s);
                }
            }
        }
    }
}

simd_dispatch! {
    /// Which agents' circles touch the one of an agent within the horizon; true also where that is not sure.
    fn circles_may_meet(
        own: [Real; NUM_COLUMNS],
        columns: &[&[Real]; NUM_COLUMNS],
        horizon_s: Real,
        may_meet: &mut [[u8; LANES]],
    ) {
        let [xs, ys, vxs, vys, radii] = columns.map(|column| &column.as_chunks::<LANES>().0[..may_meet.len()]);
        for (block, may_meet) in may_meet.iter_mut().enumerate() {
            for lane in 0..LANES {
                let (dx, dy) = (xs[block][lane] - own[0], ys[block][lane] - own[1]);
                let (wx, wy) = (vxs[block][lane] - own[2], vys[block][lane] - own[3]);
                let reach = radii[block][lane] + own[4];
                let (dw, ww) = (dx * wx + dy * wy, wx * wx + wy * wy);
                let gap = dx * dx + dy * dy - reach * reach;
                // the circles touch when |d + w t| = reach: at t = (−dw − √(dw² − ww gap)) / ww; later than the horizon
                // where −dw − horizon · ww is more than the root
                let discriminant = dw * dw - ww * gap;
                let over = -dw - horizon_s * ww;
                let late = (over > UNSURE * -dw) & (over * over > (1.0 + 10.0 * UNSURE) * discriminant);
                let apart = (gap > 0.0) & ((dw >= 0.0) | (discriminant < 0.0) | late);
                may_meet[lane] = u8::from(!apart & (reach >= 0.0));
            }
        }
    }
}

/// First time at which two agents touch when both keep their velocities, seconds; `None` beyond the horizon, between
/// levels and between hitched vehicles.
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
    if !states.same_level(i, j) || states.hitched(i, j) {
        return None;
    }
    let (a, b) = (states.oriented_box(i, &footprints[i]), states.oriented_box(j, &footprints[j]));
    a.time_to_contact(states.velocity(i), &b, states.velocity(j), horizon_s)
}
