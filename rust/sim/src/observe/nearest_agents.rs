//! Which agents are nearest.

use crate::geom::Real;
use crate::simd_dispatch::simd_dispatch;
use crate::state::AgentStates;

/// Finds the nearest agents of one observer after the other; each search begins with the observer's last order.
#[derive(Debug, Clone)]
pub(super) struct NearestAgents {
    most: usize,
    radius_m: Real,
    /// Squared distances of all agents, infinite where they are not seen.
    distance_sq: Vec<Real>,
    /// Numbers that sort by the distance, then by the agent.
    keys: Vec<u64>,
    /// All agents in the last order of each observer, and which of these each agent has.
    orders: Vec<Vec<u32>>,
    order_of: Vec<Option<usize>>,
}

impl NearestAgents {
    /// For up to `most` agents within a distance.
    pub(super) fn new(most: usize, radius_m: Real) -> Self {
        let (distance_sq, keys, orders, order_of) = Default::default();
        Self { most, radius_m, distance_sq, keys, orders, order_of }
    }

    /// Forgets all orders; to be called before [`Self::find`] in each scene.
    pub(super) fn enter(&mut self, num_agents: usize) {
        self.distance_sq.resize(num_agents, 0.0);
        self.keys.resize(num_agents, 0);
        self.order_of.clear();
        self.order_of.resize(num_agents, None);
        self.orders.iter_mut().for_each(Vec::clear);
    }

    /// Active agents of its level other than `agent_idx` within the distance, nearest first, ties by index.
    pub(super) fn find(&mut self, states: &AgentStates, agent_idx: usize) -> &[u32] {
        let (place, limit_sq) = (states.position(agent_idx), self.radius_m * self.radius_m);
        let distance_sq = &mut self.distance_sq[..];
        squared_distances(&states.x, &states.y, &states.active, place.into(), limit_sq, distance_sq);
        distance_sq[agent_idx] = Real::INFINITY;
        if !states.heights.is_empty() {
            for (other, sq) in distance_sq.iter_mut().enumerate() {
                *sq = if states.same_level(agent_idx, other) { *sq } else { Real::INFINITY };
            }
        }
        let orders = &mut self.orders;
        let order_idx = *self.order_of[agent_idx].get_or_insert_with(|| {
            let free = orders.iter().position(Vec::is_empty).unwrap_or(orders.len());
            orders.resize(orders.len().max(free + 1), Vec::new());
            free
        });
        let (order, keys) = (&mut orders[order_idx], &mut self.keys);
        // distances are not negative, so their bits sort as they do
        let key = |agent: u32| u64::from(distance_sq[agent as usize].to_bits()) << 32 | u64::from(agent);
        if order.is_empty() {
            order.extend(0..states.len() as u32);
            keys.iter_mut().zip(&*order).for_each(|(to, agent)| *to = key(*agent));
            keys.sort_unstable();
        } else {
            // by insertion: few have passed others
            for (rank, agent) in order.iter().enumerate() {
                let (key, mut at) = (key(*agent), rank);
                while at > 0 && keys[at - 1] > key {
                    keys[at] = keys[at - 1];
                    at -= 1;
                }
                keys[at] = key;
            }
        }
        order.iter_mut().zip(&*keys).for_each(|(agent, key)| *agent = *key as u32);
        let beyond = u64::from(Real::INFINITY.to_bits()) << 32;
        &order[..keys.iter().take(self.most).take_while(|key| **key < beyond).count()]
    }
}

simd_dispatch! {
    /// Squared distances of agents from a place; infinite for those that are not there or beyond a limit.
    fn squared_distances(
        xs: &[Real], ys: &[Real], active: &[bool], place: [Real; 2], limit_sq: Real, distance_sq: &mut [Real],
    ) {
        for (sq, ((x, y), active)) in distance_sq.iter_mut().zip(xs.iter().zip(ys).zip(active)) {
            let (dx, dy) = (x - place[0], y - place[1]);
            let distance_sq = dx * dx + dy * dy;
            *sq = if *active & (distance_sq <= limit_sq) { distance_sq } else { Real::INFINITY };
        }
    }
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

    proptest! {
        #[test]
        fn the_order_is_that_of_a_sort_whatever_was_asked_before(
            places in (1usize..200).prop_flat_map(|n| {
                let place = |most: i16| prop::collection::vec((-most..most, -most..most, any::<bool>()), n..=n);
                [place(90i16), place(9), place(90)]
            }),
            most in 0usize..80,
        ) {
            let mut nearest = NearestAgents::new(most, 70.0);
            nearest.enter(places[0].len());
            for (places, observer) in places.iter().zip([0, places[0].len() - 1, 0]) {
                let mut expected: Vec<(i32, usize)> = (0..places.len())
                    .filter(|j| places[*j].2 && *j != observer)
                    .map(|j| {
                        let (dx, dy) = (places[j].0 - places[observer].0, places[j].1 - places[observer].1);
                        (i32::from(dx).pow(2) + i32::from(dy).pow(2), j)
                    })
                    .filter(|(d, _)| *d <= 4900)
                    .collect();
                expected.sort_unstable();
                expected.truncate(most);
                let got: Vec<_> = nearest.find(&states(places), observer).iter().map(|a| *a as usize).collect();
                prop_assert_eq!(got, expected.into_iter().map(|(_, j)| j).collect::<Vec<_>>());
            }
        }
    }
}
