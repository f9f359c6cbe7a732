//! The random numbers of one world: a counter generator, so that its state is one number.

use serde::{Deserialize, Serialize};

/// SplitMix64 (Steele, Lea, Flood 2014): 64 bits per draw from a 64-bit counter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Rng {
    counter: u64,
}

const GOLDEN: u64 = 0x9E37_79B9_7F4A_7C15;

fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

impl Rng {
    /// Generator of a seed; every seed is legal and neighbouring seeds give unrelated streams.
    pub fn new(seed: u64) -> Self {
        Self { counter: mix(seed.wrapping_add(GOLDEN)) }
    }

    /// Generator of an episode, the n-th of a seed: later ones are children of the first. The plain child n of a seed would be
    /// the child `seed` of n.
    pub fn of_episode(seed: u64, number: u64) -> Self {
        let first = Self::new(seed).split(1);
        if number == 1 { first } else { first.split(number) }
    }

    /// Next 64 random bits.
    pub fn next_u64(&mut self) -> u64 {
        self.counter = self.counter.wrapping_add(GOLDEN);
        mix(self.counter)
    }

    /// Generator of the n-th child stream; the stream itself does not move.
    pub fn split(&self, n: u64) -> Self {
        Self { counter: mix(self.counter ^ mix(n.wrapping_add(GOLDEN))) }
    }

    /// A number in 0..n, n > 0, by multiply and shift (bias below 2⁻³² for n < 2³²).
    pub fn below(&mut self, n: usize) -> usize {
        ((u128::from(self.next_u64()) * n as u128) >> 64) as usize
    }

    /// A number in [0, 1).
    pub(crate) fn uniform(&mut self) -> f32 {
        (self.next_u64() >> 40) as f32 * (1.0 / (1u32 << 24) as f32)
    }

    /// A standard normal number (Box-Muller).
    pub(crate) fn normal(&mut self) -> f32 {
        let unit = |bits: u64| (bits >> 11) as f64 * (1.0 / (1u64 << 53) as f64);
        let radius = (-2.0 * libm::log(1.0 - unit(self.next_u64()))).sqrt();
        (radius * libm::cos(std::f64::consts::TAU * unit(self.next_u64()))) as f32
    }

    /// An index drawn by weights, given as their running sums, of which the last is positive; one draw, as [`Rng::below`].
    pub fn pick(&mut self, sums: &[f64]) -> usize {
        let total = sums.last().copied().unwrap_or_default();
        // 53 bits: the greatest multiple of 2⁻⁵³ below one
        let at = (self.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64) * total;
        sums.partition_point(|sum| *sum <= at).min(sums.len() - 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_output_of_the_published_generator() {
        // SplitMix64 seeded with the counter 0 starts with this number.
        let mut rng = Rng { counter: 0 };
        assert_eq!(rng.next_u64(), 0xE220_A839_7B1D_CDAF);
    }

    #[test]
    fn no_two_episodes_have_the_same_stream() {
        let all = (0..40).flat_map(|seed| (0..40).map(move |n| Rng::of_episode(seed, n).counter));
        let mut found: Vec<u64> = all.collect();
        found.sort_unstable();
        found.dedup();
        assert_eq!(found.len(), 1600);
    }
}
