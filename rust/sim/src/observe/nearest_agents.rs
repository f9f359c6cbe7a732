//! Which agents are nearest.

use crate::geom::Real;
use crate::state::AgentStates;

/// How much farther the farthest agent of an observer may be in the next step for the guess to hold, metres.
const MARGIN_M: Real = 1.0;

/// Finds the nearest agents of one observer after the other.
///
/// How far each observer's farthest one was the last time is a guess for the next: where there are enough agents within a
/// little more, the others are left out. The outcome is the same whatever the guess.
///
/// Memory: 4 bytes for each agent.
#[derive(Debug, Clone)]
pub(super) struct NearestAgents {
    most: usize,
    radius_m: Real,
    /// Agents and their places, infinite for those that are not there.
    agents: Vec<u32>,
    x: Vec<Real>,
    y: Vec<Real>,
    /// Agents within a distance, see [`key`]; the agents in order.
    keys: Vec<u64>,
    sorted: Vec<u32>,
    /// Distance of each observer's farthest agent; infinite where there was room for more.
    farthest_m: Vec<Real>,
}

impl NearestAgents {
    /// For up to `most` agents within a distance.
    pub(super) fn new(most: usize, radius_m: Real) -> Self {
        let (agents, sorted) = Default::default();
        let (x, y, farthest_m) = Default::default();
        Self { most, radius_m, agents, x, y, keys: Vec::new(), sorted, farthest_m }
    }

    /// Takes the places of all agents; to be called before [`Self::find`] whenever they have changed. Whether those that are
    /// not there are left out, which pays for many observers, makes no difference to what is found.
    pub(super) fn prepare(&mut self, states: &AgentStates, leaves_out: bool) {
        let num_agents = states.len();
        self.agents.clear();
        self.x.clear();
        self.y.clear();
        for (agent_idx, active) in states.active.iter().enumerate() {
            if *active || !leaves_out {
                self.agents.push(agent_idx as u32);
                self.x.push(if *active { states.x[agent_idx] } else { Real::INFINITY });
                self.y.push(states.y[agent_idx]);
            }
        }
        self.keys.resize(num_agents + 1, 0);
        self.sorted.reserve(num_agents);
        self.farthest_m.resize(num_agents, Real::INFINITY);
    }

    /// Active agents of its level other than `agent_idx` within the distance, nearest first, ties by index.
    pub(super) fn find(&mut self, states: &AgentStates, agent_idx: usize) -> &[u32] {
        if !states.heights.is_empty() {
            for (x, other) in self.x.iter_mut().zip(&self.agents) {
                let other = *other as usize;
                let is_seen = states.active[other] && states.same_level(agent_idx, other);
                *x = if is_seen { states.x[other] } else { Real::INFINITY };
            }
        }
        let reach_sq = self.radius_m * self.radius_m;
        let guess_m = self.farthest_m[agent_idx] + MARGIN_M;
        let limit_sq = if guess_m < self.radius_m { guess_m * guess_m } else { reach_sq };
        let mut num_near = self.gather(states, agent_idx, limit_sq);
        if num_near < self.most && limit_sq < reach_sq {
            num_near = self.gather(states, agent_idx, reach_sq);
        }
        let near = &mut self.keys[..num_near];
        near.sort_unstable();
        self.sorted.clear();
        self.sorted.extend(near.iter().take(self.most).map(|key| *key as u32));
        let last = self.sorted.last().filter(|_| self.sorted.len() == self.most);
        self.farthest_m[agent_idx] = last.map_or(Real::INFINITY, |last| {
            (states.position(*last as usize) - states.position(agent_idx)).norm()
        });
        &self.sorted
    }

    /// Gathers the keys of the agents within a distance; returns their number.
    fn gather(&mut self, states: &AgentStates, agent_idx: usize, limit_sq: Real) -> usize {
        let [own_x, own_y] = [states.x[agent_idx], states.y[agent_idx]];
        let mut num_near = 0;
        for ((agent, x), y) in self.agents.iter().zip(&self.x).zip(&self.y) {
            let (dx, dy) = (x - own_x, y - own_y);
            let distance_sq = dx * dx + dy * dy;
            // written always, kept if near: no branch to guess
            self.keys[num_near] = key(distance_sq, *agent);
            num_near += usize::from(distance_sq <= limit_sq && *agent as usize != agent_idx);
        }
        num_near
    }
}

/// A number that sorts by the distance, then by the agent.
#[inline(always)]
fn key(distance_sq: Real, agent_idx: u32) -> u64 {
    // distances are not negative, so their bits sort as they do
    u64::from(distance_sq.to_bits()) << 32 | u64::from(agent_idx)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::{Pose2, Vector2};
    use proptest::prelude::*;

    fn states(places: &[(i16, i16, bool)]) -> AgentStates {
        let mut states = AgentStates::new(places.len());
        for (a, (x, y, active)) in places.iter().enumerate() {
            states.set_pose(a, Pose2::new(Real::from(*x), Real::from(*y), 0.0), Vector2::zeros());
            states.active[a] = *active;
        }
        states
    }

    fn places(most: usize) -> impl Strategy<Value = Vec<(i16, i16, bool)>> {
        let wide = prop::collection::vec((-90i16..90, -90i16..90, any::<bool>()), 1..most);
        let narrow = prop::collection::vec((-9i16..9, -9i16..9, any::<bool>()), 1..most);
        prop_oneof![wide, narrow]
    }

    proptest! {
        #[test]
        fn the_order_is_that_of_a_sort_whatever_was_asked_before(
            before in places(300), after in places(300), most in 0usize..80, leaves_out in any::<bool>(),
        ) {
            let mut nearest = NearestAgents::new(most, 70.0);
            for places in [&before, &after, &after] {
                let states = states(places);
                let mut expected: Vec<(i32, usize)> = (1..places.len())
                    .filter(|j| places[*j].2)
                    .map(|j| {
                        let (dx, dy) = (places[j].0 - places[0].0, places[j].1 - places[0].1);
                        (i32::from(dx).pow(2) + i32::from(dy).pow(2), j)
                    })
                    .filter(|(d, _)| *d <= 4900)
                    .collect();
                expected.sort_unstable();
                expected.truncate(most);
                nearest.prepare(&states, leaves_out);
                let got: Vec<usize> = nearest.find(&states, 0).iter().map(|a| *a as usize).collect();
                prop_assert_eq!(got, expected.into_iter().map(|(_, j)| j).collect::<Vec<_>>());
            }
        }
    }
}
