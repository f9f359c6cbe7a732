//! Which agents are nearest.

use crate::geom::Real;
use crate::simd_dispatch::simd_dispatch;
use crate::state::AgentStates;

/// Most agents that are put in order by counting for each those that are nearer.
const MOST_COUNTED: usize = 128;
/// Agents that are counted at once.
const LANES: usize = 32;
/// Agents gathered at once.
const BLOCK: usize = 8;
/// Distances are counted in whole steps; so many make the farthest.
const STEPS: Real = 32_000.0;
/// How much farther the farthest agent of an observer may be in the next step for the guess to hold, metres.
const MARGIN_M: Real = 1.0;
/// Steps of what is beyond every candidate.
const BEYOND: i16 = i16::MAX;

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
    /// Agents, and their places: whole blocks, with infinite places of those that are not there, then whatever else.
    num_listed: usize,
    num_padded: usize,
    agents: Vec<u32>,
    x: Vec<Real>,
    y: Vec<Real>,
    /// Place of each agent among these.
    at: Vec<u32>,
    /// Agents within a distance and their squared distances, then whatever else; the agents in order.
    near: Vec<u32>,
    near_sq: Vec<Real>,
    sorted: Vec<u32>,
    keys: Vec<u64>,
    /// Distances in steps, and the number of agents that are nearer.
    steps: Box<[i16; MOST_COUNTED]>,
    ranks: Box<[i16; MOST_COUNTED]>,
    /// Distance of each observer's farthest agent; infinite where there was room for more.
    farthest_m: Vec<Real>,
}

impl NearestAgents {
    /// For up to `most` agents within a distance.
    pub(super) fn new(most: usize, radius_m: Real) -> Self {
        Self {
            most,
            radius_m,
            num_listed: 0,
            num_padded: 0,
            agents: Vec::new(),
            x: Vec::new(),
            y: Vec::new(),
            at: Vec::new(),
            near: Vec::new(),
            near_sq: Vec::new(),
            sorted: Vec::new(),
            keys: Vec::new(),
            steps: Box::new([0; MOST_COUNTED]),
            ranks: Box::new([0; MOST_COUNTED]),
            farthest_m: Vec::new(),
        }
    }

    /// Takes the places of all agents; to be called before [`Self::find`] whenever they have changed. Whether those that are
    /// not there are left out, which pays for many observers, makes no difference to what is found.
    pub(super) fn prepare(&mut self, states: &AgentStates, leaves_out: bool) {
        let (num_agents, room) = (states.len(), states.len() + BLOCK);
        self.agents.resize(room, 0);
        [&mut self.x, &mut self.y].into_iter().for_each(|column| column.resize(room, 0.0));
        self.at.resize(num_agents, 0);
        let (agents, x, y) = (&mut self.agents[..room], &mut self.x[..room], &mut self.y[..room]);
        let places = states.x.iter().zip(&states.y).zip(&states.active);
        let mut n = 0;
        for (agent_idx, (((px, py), active), at)) in places.zip(&mut self.at).enumerate() {
            // written always, kept if there: no branch to guess
            (agents[n], x[n], y[n]) = (agent_idx as u32, if *active { *px } else { Real::INFINITY }, *py);
            *at = n as u32;
            n += usize::from(*active | !leaves_out);
        }
        (self.num_listed, self.num_padded) = (n, n.next_multiple_of(BLOCK));
        x[n..self.num_padded].fill(Real::INFINITY);
        self.near.resize(room, 0);
        self.near_sq.resize(room, 0.0);
        self.sorted.resize(room.max(MOST_COUNTED), 0);
        self.farthest_m.resize(num_agents, Real::INFINITY);
    }

    /// Active agents of its level other than `agent_idx` within the distance, nearest first, ties by index.
    pub(super) fn find(&mut self, states: &AgentStates, agent_idx: usize) -> &[u32] {
        if !states.heights.is_empty() {
            for (x, other) in self.x[..self.num_listed].iter_mut().zip(&self.agents) {
                let other = *other as usize;
                let is_seen = states.active[other] && states.same_level(agent_idx, other);
                *x = if is_seen { states.x[other] } else { Real::INFINITY };
            }
        }
        let reach_sq = self.radius_m * self.radius_m;
        let guess_m = self.farthest_m[agent_idx] + MARGIN_M;
        let mut limit_sq = if guess_m < self.radius_m { guess_m * guess_m } else { reach_sq };
        let mut num_near = self.gather(states, agent_idx, limit_sq);
        if num_near < self.most && limit_sq < reach_sq {
            limit_sq = reach_sq;
            num_near = self.gather(states, agent_idx, limit_sq);
        }
        self.sort(num_near, limit_sq);
        let num_found = num_near.min(self.most);
        let last = self.sorted[..num_found].last().filter(|_| num_found == self.most);
        self.farthest_m[agent_idx] = last.map_or(Real::INFINITY, |last| {
            (states.position(*last as usize) - states.position(agent_idx)).norm()
        });
        &self.sorted[..num_found]
    }

    /// Gathers the agents within a distance; returns their number.
    fn gather(&mut self, states: &AgentStates, agent_idx: usize, limit_sq: Real) -> usize {
        // nobody is near to itself
        let own = Some(self.at[agent_idx] as usize).filter(|_| states.active[agent_idx]);
        let x = own.map(|at| std::mem::replace(&mut self.x[at], Real::INFINITY));
        let place = [states.x[agent_idx], states.y[agent_idx]];
        let mut num_near = 0;
        let places = [&self.x[..self.num_padded], &self.y[..self.num_padded]];
        gather(
            places,
            &self.agents[..self.num_padded],
            place,
            limit_sq,
            &mut self.near,
            &mut self.near_sq,
            &mut num_near,
        );
        if let (Some(at), Some(x)) = (own, x) {
            self.x[at] = x;
        }
        num_near
    }

    /// Puts the first of the gathered agents in order: a few by counting for each those of fewer steps, many by the
    /// library's sort.
    fn sort(&mut self, num_near: usize, limit_sq: Real) {
        let (near, near_sq) = (&self.near[..num_near], &self.near_sq[..num_near]);
        let (Some(sorted), true) = (self.sorted.first_chunk_mut::<MOST_COUNTED>(), num_near <= MOST_COUNTED)
        else {
            self.keys.clear();
            self.keys.extend(near.iter().zip(near_sq).map(|(agent, sq)| key(*sq, *agent)));
            self.keys.sort_unstable();
            self.sorted.iter_mut().zip(&self.keys).for_each(|(agent, key)| *agent = *key as u32);
            return;
        };
        let padded = num_near.next_multiple_of(LANES);
        to_steps(near_sq, STEPS / limit_sq.sqrt(), &mut self.steps[..]);
        self.steps[num_near..padded].fill(BEYOND);
        count_nearer(&self.steps[..padded], num_near, &mut self.ranks[..]);
        let ranks = &self.ranks[..num_near];
        for (agent, rank) in near.iter().zip(ranks) {
            sorted[*rank as usize % MOST_COUNTED] = *agent;
        }
        // ranks of which two are the same add up to less than 0 + 1 + 2 + …
        let sum: i32 = ranks.iter().map(|rank| i32::from(*rank)).sum();
        if 2 * sum as usize != num_near * num_near.saturating_sub(1) {
            let keys = near.iter().zip(near_sq).map(|(agent, sq)| key(*sq, *agent));
            place_with_ties(keys.zip(ranks.iter().copied()), &mut sorted[..num_near]);
        }
    }
}

/// A number that sorts by the distance, then by the agent.
#[inline(always)]
fn key(distance_sq: Real, agent_idx: u32) -> u64 {
    // distances are not negative, so their bits sort as they do
    u64::from(distance_sq.to_bits()) << 32 | u64::from(agent_idx)
}

/// Puts the agents of keys in order of which the ranks say how many have a lesser number of steps.
fn place_with_ties(keys: impl Iterator<Item = (u64, i16)>, sorted: &mut [u32]) {
    let (mut num_placed, mut placed) = ([0u8; MOST_COUNTED], [0; MOST_COUNTED]);
    for (key, rank) in keys {
        let rank = rank as usize % MOST_COUNTED;
        let mut at = rank + usize::from(num_placed[rank]);
        num_placed[rank] += 1;
        while at > rank && placed[at - 1] > key {
            placed[at] = placed[at - 1];
            at -= 1;
        }
        placed[at] = key;
    }
    sorted.iter_mut().zip(placed).for_each(|(agent, key)| *agent = key as u32);
}

simd_dispatch! {
    /// Writes the agents within a distance of a place with their squared distances, and their number; there needs to be room
    /// for one block more.
    fn gather(
        places: [&[Real]; 2], agents: &[u32], place: [Real; 2], limit_sq: Real, near: &mut [u32], near_sq: &mut [Real], num_near: &mut usize,
    ) with pack [Fn(&Block, Real) -> (Block, usize)] = pack, pack_avx2 {
        let mut n = 0;
        let [xs, ys] = places.map(|column| column.as_chunks::<BLOCK>().0);
        for ((xs, ys), agents) in xs.iter().zip(ys).zip(agents.as_chunks::<BLOCK>().0) {
            let distance_sq = std::array::from_fn(|lane| {
                let (dx, dy) = (xs[lane] - place[0], ys[lane] - place[1]);
                dx * dx + dy * dy
            });
            let (packed, num_packed) = pack(&Block { agents: *agents, distance_sq }, limit_sq);
            let room = near.get_mut(n..).and_then(|near| near.first_chunk_mut::<BLOCK>());
            if let (Some(to), Some(to_sq)) = (room, near_sq.get_mut(n..).and_then(|near| near.first_chunk_mut::<BLOCK>())) {
                (*to, *to_sq) = (packed.agents, packed.distance_sq);
            }
            n += num_packed;
        }
        *num_near = n;
    }

    /// Squared distances in whole steps; never fewer steps for a greater distance.
    fn to_steps(distance_sq: &[Real], steps_per_metre: Real, steps: &mut [i16]) {
        for (step, distance_sq) in steps.iter_mut().zip(distance_sq) {
            // added to this number, a float has its whole part in its lowest bits
            let whole = distance_sq.sqrt() * steps_per_metre + 8_388_608.0;
            *step = (whole.to_bits() & 0x7fff) as i16;
        }
    }

    /// For each of the first steps the number of lesser ones among all.
    fn count_nearer(steps: &[i16], num_keys: usize, ranks: &mut [i16])
    with count [Fn(&[i16; LANES], &[i16]) -> [i16; LANES]] = count_less, count_less_avx2 {
        let (own, _) = steps.as_chunks::<LANES>();
        let (ranks, _) = ranks.as_chunks_mut::<LANES>();
        for (ranks, own) in ranks.iter_mut().zip(own) {
            *ranks = count(own, &steps[..num_keys]);
        }
    }
}

/// Agents and their squared distances.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Block {
    agents: [u32; BLOCK],
    distance_sq: [Real; BLOCK],
}

/// Those of a block's agents that are within a limit, then whatever else; and their number.
#[inline(always)]
fn pack(block: &Block, limit_sq: Real) -> (Block, usize) {
    let (mut packed, mut n) = (*block, 0);
    for (agent, d) in block.agents.iter().zip(block.distance_sq) {
        // written always, kept if near: no branch to guess
        (packed.agents[n % BLOCK], packed.distance_sq[n % BLOCK]) = (*agent, d);
        n += usize::from(d <= limit_sq);
    }
    (packed, n)
}

/// For each set of a block's agents, by its bits, these one after the other, a byte each.
#[cfg(target_arch = "x86_64")]
static AGENTS_OF: [[u8; BLOCK]; 1 << BLOCK] = {
    let mut agents = [[0; BLOCK]; 1 << BLOCK];
    let mut set = 0;
    while set < agents.len() {
        let (mut lane, mut n) = (0, 0);
        while lane < BLOCK {
            if set >> lane & 1 == 1 {
                agents[set][n] = lane as u8;
                n += 1;
            }
            lane += 1;
        }
        set += 1;
    }
    agents
};

/// [`pack`] in vectors.
#[cfg(target_arch = "x86_64")]
#[inline]
#[target_feature(enable = "avx2")]
#[allow(unsafe_code, reason = "arrays and vectors of the same numbers are the same bytes")]
fn pack_avx2(block: &Block, limit_sq: Real) -> (Block, usize) {
    use std::arch::x86_64::*;
    // SAFETY: eight floats
    let distance_sq: __m256 = unsafe { std::mem::transmute(block.distance_sq) };
    // SAFETY: eight numbers of 32 bits
    let agents: __m256i = unsafe { std::mem::transmute(block.agents) };
    let near = _mm256_cmp_ps::<_CMP_LE_OQ>(distance_sq, _mm256_set1_ps(limit_sq));
    let set = _mm256_movemask_ps(near) as usize % (1 << BLOCK);
    let lanes = _mm256_cvtepu8_epi32(_mm_cvtsi64_si128(i64::from_le_bytes(AGENTS_OF[set])));
    // SAFETY: as above
    let (agents, distance_sq) = unsafe {
        (
            std::mem::transmute::<__m256i, [u32; BLOCK]>(_mm256_permutevar8x32_epi32(agents, lanes)),
            std::mem::transmute::<__m256, [Real; BLOCK]>(_mm256_permutevar8x32_ps(distance_sq, lanes)),
        )
    };
    (Block { agents, distance_sq }, set.count_ones() as usize)
}

/// For each of some numbers the count of others that are less.
#[inline(always)]
fn count_less(own: &[i16; LANES], others: &[i16]) -> [i16; LANES] {
    let mut counts = [0; LANES];
    for other in others {
        for lane in 0..LANES {
            counts[lane] += i16::from(*other < own[lane]);
        }
    }
    counts
}

/// [`count_less`] in two vectors.
#[cfg(target_arch = "x86_64")]
#[inline]
#[target_feature(enable = "avx2")]
#[allow(unsafe_code, reason = "arrays and vectors of the same numbers are the same bytes")]
fn count_less_avx2(own: &[i16; LANES], others: &[i16]) -> [i16; LANES] {
    use std::arch::x86_64::*;
    // SAFETY: 32 numbers of 16 bits
    let own: [__m256i; 2] = unsafe { std::mem::transmute(*own) };
    let mut counts = [_mm256_setzero_si256(); 2];
    for other in others {
        let other = _mm256_set1_epi16(*other);
        // true is minus one
        counts[0] = _mm256_sub_epi16(counts[0], _mm256_cmpgt_epi16(own[0], other));
        counts[1] = _mm256_sub_epi16(counts[1], _mm256_cmpgt_epi16(own[1], other));
    }
    // SAFETY: as above
    unsafe { std::mem::transmute(counts) }
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
    #[cfg(target_arch = "x86_64")]
    proptest! {
        #[test]
        #[allow(unsafe_code, reason = "the function is called where the processor has the instructions")]
        fn both_ways_to_pack_agree(
            whole in prop::array::uniform8(0u8..9), limit in 0u8..9, first in 0u32..1 << 20, beyond in 0usize..BLOCK,
        ) {
            let agents = std::array::from_fn(|lane| first + lane as u32);
            let mut block = Block { agents, distance_sq: whole.map(Real::from) };
            block.distance_sq[beyond] = Real::INFINITY;
            if std::arch::is_x86_feature_detected!("avx2") {
                // SAFETY: just asked
                let (wide, num_wide) = unsafe { pack_avx2(&block, limit.into()) };
                let (packed, n) = pack(&block, limit.into());
                prop_assert_eq!((&wide.agents[..n], num_wide), (&packed.agents[..n], n));
                prop_assert_eq!(&wide.distance_sq[..n], &packed.distance_sq[..n]);
            }
        }

        #[test]
        #[allow(unsafe_code, reason = "the function is called where the processor has the instructions")]
        fn both_ways_to_count_agree(
            own in prop::collection::vec(0i16..99, LANES), others in prop::collection::vec(0i16..99, 0..MOST_COUNTED),
        ) {
            let mut block = [0; LANES];
            block.copy_from_slice(&own);
            if std::arch::is_x86_feature_detected!("avx2") {
                // SAFETY: just asked
                let wide = unsafe { count_less_avx2(&block, &others) };
                prop_assert_eq!(wide, count_less(&block, &others));
            }
        }
    }
}
