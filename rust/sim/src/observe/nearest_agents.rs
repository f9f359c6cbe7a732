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
/// Distances are counted in whole steps; so many make the radius.
const STEPS: Real = 32_000.0;
/// Steps of what is beyond every candidate.
const BEYOND: i16 = i16::MAX;

/// Finds the nearest agents of one observer after the other.
///
/// Each observer's last answer is a hint for its next: no agent farther than the farthest of them now can be among
/// the nearest. The outcome is the same whatever the hint.
///
/// Memory: 4 bytes for each row of each observing agent, where there are more agents than rows.
#[derive(Debug, Clone)]
pub(super) struct NearestAgents {
    most: usize,
    radius_m: Real,
    distance_sq: Vec<Real>,
    /// [`key`]s of the agents within a distance by index, the same in order, and whatever else.
    near: Vec<u64>,
    sorted: Vec<u64>,
    /// Distances in steps, and the number of agents that are nearer.
    steps: Box<[i16; MOST_COUNTED]>,
    ranks: Box<[i16; MOST_COUNTED]>,
    last: Vec<Vec<u32>>,
}

impl NearestAgents {
    /// For up to `most` agents within a distance.
    pub(super) fn new(most: usize, radius_m: Real) -> Self {
        Self {
            most,
            radius_m,
            distance_sq: Vec::new(),
            near: Vec::new(),
            sorted: Vec::new(),
            steps: Box::new([0; MOST_COUNTED]),
            ranks: Box::new([0; MOST_COUNTED]),
            last: Vec::new(),
        }
    }

    /// Active agents other than `agent_idx` within the distance, nearest first, ties by index: the agent in the low,
    /// the bits of the squared distance in the high half of each number.
    pub(super) fn find(&mut self, states: &AgentStates, agent_idx: usize) -> &[u64] {
        let num_agents = states.len();
        let reach_sq = self.radius_m * self.radius_m;
        self.distance_sq.resize(num_agents, 0.0);
        measure(states, agent_idx, reach_sq, &mut self.distance_sq);
        let limit_sq = if num_agents > self.most + 1 { self.hinted_limit_sq(agent_idx) } else { reach_sq };
        let limit_sq = limit_sq.min(reach_sq);
        self.near.resize(num_agents + BLOCK, 0);
        let mut num_near = 0;
        gather(&self.distance_sq, limit_sq, &mut self.near, &mut num_near);
        self.sort(num_near);
        let sorted = &self.sorted[..num_near.min(self.most)];
        if num_agents > self.most + 1 {
            let last = &mut self.last[agent_idx];
            last.clear();
            last.extend(sorted.iter().map(|key| (key & 0xffff_ffff) as u32));
        }
        sorted
    }

    /// A squared distance within which there are as many agents as there are rows, if the last answer gives one.
    fn hinted_limit_sq(&mut self, agent_idx: usize) -> Real {
        if self.last.len() < self.distance_sq.len() {
            self.last.resize(self.distance_sq.len(), Vec::new());
        }
        let last = &self.last[agent_idx];
        if last.len() < self.most {
            return Real::INFINITY;
        }
        // an agent of another scene may be none of this one
        let far = |j: u32| self.distance_sq.get(j as usize).copied().unwrap_or(Real::INFINITY);
        // several at a time, and one instruction each, which `max` is not
        let mut farthest = [0.0; BLOCK];
        for block in last.chunks(BLOCK) {
            for (farthest, j) in farthest.iter_mut().zip(block) {
                let far = far(*j);
                *farthest = if far > *farthest { far } else { *farthest };
            }
        }
        farthest.into_iter().fold(0.0, Real::max)
    }

    /// Puts the first of the gathered keys in order: a few by counting for each those of fewer steps, many by the
    /// library's sort.
    fn sort(&mut self, num_near: usize) {
        self.sorted.resize(self.near.len().max(MOST_COUNTED), 0);
        let near = &self.near[..num_near];
        let (Some(sorted), true) = (self.sorted.first_chunk_mut::<MOST_COUNTED>(), num_near <= MOST_COUNTED)
        else {
            self.sorted[..num_near].copy_from_slice(near);
            self.sorted[..num_near].sort_unstable();
            return;
        };
        let padded = num_near.next_multiple_of(LANES);
        to_steps(near, STEPS / self.radius_m, &mut self.steps[..]);
        self.steps[num_near..padded].fill(BEYOND);
        count_nearer(&self.steps[..padded], num_near, &mut self.ranks[..]);
        let ranks = &self.ranks[..num_near];
        for (key, rank) in near.iter().zip(ranks) {
            sorted[*rank as usize % MOST_COUNTED] = *key;
        }
        // ranks of which two are the same add up to less than 0 + 1 + 2 + …
        let sum: usize = ranks.iter().map(|rank| *rank as usize).sum();
        if 2 * sum != num_near * num_near.saturating_sub(1) {
            place_with_ties(near.iter().copied().zip(ranks.iter().copied()), &mut sorted[..num_near]);
        }
    }
}

/// A number that sorts by the distance, then by the agent.
#[inline(always)]
fn key(distance_sq: Real, agent_idx: usize) -> u64 {
    // distances are not negative, so their bits sort as they do
    u64::from(distance_sq.to_bits()) << 32 | agent_idx as u64
}

/// Puts keys in order of which the ranks say how many have a lesser number of steps.
fn place_with_ties(keys: impl Iterator<Item = (u64, i16)>, sorted: &mut [u64]) {
    let mut num_placed = [0u8; MOST_COUNTED];
    for (key, rank) in keys {
        let rank = rank as usize % MOST_COUNTED;
        let mut at = rank + usize::from(num_placed[rank]);
        num_placed[rank] += 1;
        while at > rank && sorted[at - 1] > key {
            sorted[at] = sorted[at - 1];
            at -= 1;
        }
        sorted[at] = key;
    }
}

simd_dispatch! {
    /// Squared distances from an agent; infinite for itself, and for agents that are out of reach or not there.
    fn measure(states: &AgentStates, agent_idx: usize, reach_sq: Real, distance_sq: &mut [Real]) {
        let (x, y) = (states.x[agent_idx], states.y[agent_idx]);
        let places = states.x.iter().zip(&states.y).zip(&states.active);
        for (d, ((px, py), active)) in distance_sq.iter_mut().zip(places) {
            let (dx, dy) = (px - x, py - y);
            let sq = dx * dx + dy * dy;
            *d = if *active & (sq <= reach_sq) { sq } else { Real::INFINITY };
        }
        distance_sq[agent_idx] = Real::INFINITY;
    }

    /// Writes the keys of the agents within a distance, and their number; the keys need room for one block more.
    fn gather(distance_sq: &[Real], limit_sq: Real, keys: &mut [u64], num_keys: &mut usize)
    with pack [Fn(&[Real; BLOCK], (Real, u32)) -> ([u64; BLOCK], usize)] = pack, pack_avx2 {
        let mut n = 0;
        for (block_idx, block) in distance_sq.chunks(BLOCK).enumerate() {
            let mut distances = [Real::INFINITY; BLOCK];
            match block.first_chunk::<BLOCK>() {
                Some(block) => distances = *block,
                None => distances[..block.len()].copy_from_slice(block),
            }
            let (packed, num_near) = pack(&distances, (limit_sq, (block_idx * BLOCK) as u32));
            if let Some(to) = keys.get_mut(n..).and_then(|keys| keys.first_chunk_mut::<BLOCK>()) {
                *to = packed;
            }
            n += num_near;
        }
        *num_keys = n;
    }

    /// Distances of keys in whole steps; never fewer steps for a greater distance.
    fn to_steps(keys: &[u64], steps_per_metre: Real, steps: &mut [i16]) {
        for (step, key) in steps.iter_mut().zip(keys) {
            // added to this number, a float has its whole part in its lowest bits
            let whole = Real::from_bits((key >> 32) as u32).sqrt() * steps_per_metre + 8_388_608.0;
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

/// The keys of those of a block's agents, counted from a first one, that are within a limit, then whatever else; and
/// their number.
#[inline(always)]
fn pack(distance_sq: &[Real; BLOCK], (limit_sq, first): (Real, u32)) -> ([u64; BLOCK], usize) {
    let (mut keys, mut n) = ([0; BLOCK], 0);
    for (lane, d) in distance_sq.iter().enumerate() {
        // written always, kept if near: no branch to guess
        keys[n % BLOCK] = key(*d, first as usize + lane);
        n += usize::from(*d <= limit_sq);
    }
    (keys, n)
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
fn pack_avx2(distance_sq: &[Real; BLOCK], (limit_sq, first): (Real, u32)) -> ([u64; BLOCK], usize) {
    use std::arch::x86_64::*;
    // SAFETY: eight floats
    let distance_sq: __m256 = unsafe { std::mem::transmute(*distance_sq) };
    let near = _mm256_cmp_ps::<_CMP_LE_OQ>(distance_sq, _mm256_set1_ps(limit_sq));
    let set = _mm256_movemask_ps(near) as usize % (1 << BLOCK);
    let lanes = _mm256_cvtepu8_epi32(_mm_cvtsi64_si128(i64::from_le_bytes(AGENTS_OF[set])));
    let bits = _mm256_castps_si256(_mm256_permutevar8x32_ps(distance_sq, lanes));
    let agents = _mm256_add_epi32(lanes, _mm256_set1_epi32(first as i32));
    // keys 0, 1, 4, 5 and 2, 3, 6, 7
    let (a, b) = (_mm256_unpacklo_epi32(agents, bits), _mm256_unpackhi_epi32(agents, bits));
    let keys = [_mm256_permute2x128_si256::<0x20>(a, b), _mm256_permute2x128_si256::<0x31>(a, b)];
    // SAFETY: eight numbers of 64 bits
    (unsafe { std::mem::transmute::<[__m256i; 2], [u64; BLOCK]>(keys) }, set.count_ones() as usize)
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
            before in places(300), after in places(300), most in 0usize..80,
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
                let got: Vec<usize> = nearest.find(&states, 0).iter().map(|k| (k & 0xffff_ffff) as usize).collect();
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
            let mut distance_sq = whole.map(Real::from);
            distance_sq[beyond] = Real::INFINITY;
            if std::arch::is_x86_feature_detected!("avx2") {
                // SAFETY: just asked
                let (wide, n) = unsafe { pack_avx2(&distance_sq, (limit.into(), first)) };
                let (keys, num_near) = pack(&distance_sq, (limit.into(), first));
                prop_assert_eq!((&wide[..n], n), (&keys[..num_near], num_near));
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
