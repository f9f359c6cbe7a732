//! Which agents are nearest.

use crate::geom::Real;
use crate::state::AgentStates;

/// Finds the nearest agents of one observer after the other.
///
/// From one step to the next the order hardly changes, so each observer's last order is kept and mended by insertion.
/// It is a hint only: keys of different agents differ, so the outcome is the same from whatever order one starts.
///
/// Memory: 4 bytes for each pair of an observing agent and an agent.
#[derive(Debug, Clone)]
pub(super) struct NearestAgents {
    distance_sq: Vec<Real>,
    /// (squared distance, agent), sortable as numbers.
    keys: Vec<u64>,
    orders: Vec<Vec<u32>>,
}

/// Mending is given up for sorting after this many moves per agent.
const MOVES_PER_AGENT: usize = 8;

impl NearestAgents {
    pub(super) fn new(max_agents: usize) -> Self {
        let (distance_sq, keys) = (Vec::with_capacity(max_agents), Vec::with_capacity(max_agents));
        Self { distance_sq, keys, orders: vec![Vec::new(); max_agents] }
    }

    /// Active agents other than `agent_idx` within a distance, nearest first, ties by index: the agent in the low,
    /// the bits of the squared distance in the high half of each number.
    pub(super) fn find(&mut self, states: &AgentStates, agent_idx: usize, radius_m: Real) -> &[u64] {
        let num_agents = states.len();
        let (x, y, reach_sq) = (states.x[agent_idx], states.y[agent_idx], radius_m * radius_m);
        self.distance_sq.clear();
        self.distance_sq.extend(states.x.iter().zip(&states.y).zip(&states.active).map(
            |((px, py), active)| {
                let (dx, dy) = (px - x, py - y);
                let d = dx * dx + dy * dy;
                if *active & (d <= reach_sq) { d } else { Real::INFINITY }
            },
        ));
        self.distance_sq[agent_idx] = Real::INFINITY;
        if self.orders.len() < num_agents {
            self.orders.resize(num_agents, Vec::new());
        }
        let order = &mut self.orders[agent_idx];
        if order.len() != num_agents {
            order.clear();
            order.extend(0..num_agents as u32);
        }
        let distance_sq = &self.distance_sq;
        let key = |j: &u32| u64::from(distance_sq[*j as usize].to_bits()) << 32 | u64::from(*j);
        self.keys.clear();
        self.keys.extend(order.iter().map(key));
        mend(&mut self.keys);
        for (j, key) in order.iter_mut().zip(&self.keys) {
            *j = (key & 0xffff_ffff) as u32;
        }
        let absent = u64::from(Real::INFINITY.to_bits()) << 32;
        let num_near = self.keys.partition_point(|key| *key < absent);
        &self.keys[..num_near]
    }
}

/// Sorts numbers that are nearly sorted.
fn mend(keys: &mut [u64]) {
    let mut moves_left = MOVES_PER_AGENT * keys.len();
    for i in 1..keys.len() {
        let key = keys[i];
        let mut at = i;
        while at > 0 && keys[at - 1] > key {
            keys[at] = keys[at - 1];
            at -= 1;
        }
        keys[at] = key;
        if i - at > moves_left {
            return keys.sort_unstable();
        }
        moves_left -= i - at;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::{Pose2, Vector2};
    use proptest::prelude::*;

    fn states(places: &[(i8, i8, bool)]) -> AgentStates {
        let mut states = AgentStates::new(places.len());
        for (a, (x, y, active)) in places.iter().enumerate() {
            states.place(a, Pose2::new(Real::from(*x), Real::from(*y), 0.0), Vector2::zeros());
            states.active[a] = *active;
        }
        states
    }

    proptest! {
        #[test]
        fn the_order_is_that_of_a_sort_from_whatever_order_it_starts(
            before in prop::collection::vec((-9i8..9, -9i8..9, any::<bool>()), 1..60),
            after in prop::collection::vec((-9i8..9, -9i8..9, any::<bool>()), 1..60),
        ) {
            let mut nearest = NearestAgents::new(4);
            for places in [&before, &after, &after] {
                let states = states(places);
                let mut expected: Vec<(i32, usize)> = (1..places.len())
                    .filter(|j| places[*j].2)
                    .map(|j| {
                        let (dx, dy) = (i32::from(places[j].0) - i32::from(places[0].0), i32::from(places[j].1) - i32::from(places[0].1));
                        (dx * dx + dy * dy, j)
                    })
                    .filter(|(d, _)| *d <= 100)
                    .collect();
                expected.sort_unstable();
                let got: Vec<usize> = nearest.find(&states, 0, 10.0).iter().map(|k| (k & 0xffff_ffff) as usize).collect();
                prop_assert_eq!(got, expected.into_iter().map(|(_, j)| j).collect::<Vec<_>>());
            }
        }
    }
}
