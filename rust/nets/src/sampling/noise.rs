//! Counter-based random numbers: the same (seed, stream, index) gives the same number, on any machine and in any batch.
//!
//! Philox 4x32 with ten rounds (Salmon et al., SC'11): no state, so resuming a training run or redrawing one world's
//! noise needs nothing but the counter.

/// A stream of random numbers named by a seed and a stream number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Noise {
    seed: u64,
    stream: u64,
}

impl Noise {
    /// The stream of a seed.
    pub fn new(seed: u64, stream: u64) -> Self {
        Self { seed, stream }
    }

    /// Four random words of a counter.
    pub fn block(&self, counter: u64) -> [u32; 4] {
        let mut key = [self.seed as u32, (self.seed >> 32) as u32];
        let mut c = [counter as u32, (counter >> 32) as u32, self.stream as u32, (self.stream >> 32) as u32];
        for _ in 0..10 {
            let (p0, p1) = (0xD251_1F53_u64 * u64::from(c[0]), 0xCD9E_8D57_u64 * u64::from(c[2]));
            c = [(p1 >> 32) as u32 ^ c[1] ^ key[0], p1 as u32, (p0 >> 32) as u32 ^ c[3] ^ key[1], p0 as u32];
            key = [key[0].wrapping_add(0x9E37_79B9), key[1].wrapping_add(0xBB67_AE85)];
        }
        c
    }

    /// An integer in 0..`end` (`end` > 0) for an index.
    pub fn below(&self, index: u64, end: u64) -> u64 {
        let [a, b, ..] = self.block(index);
        let wide = u128::from(u64::from(a) << 32 | u64::from(b)) * u128::from(end.max(1));
        (wide >> 64) as u64
    }

    /// A number in [0, 1) for an index.
    pub fn uniform(&self, index: u64) -> f64 {
        f64::from(self.block(index)[0]) / 4_294_967_296.0
    }

    /// `count` standard normal numbers, the first of them at counter 0.
    pub fn normals(&self, count: usize) -> Vec<f32> {
        let mut out = Vec::with_capacity(count + 3);
        for counter in 0..count.div_ceil(4) as u64 {
            for pair in self.block(counter).chunks_exact(2) {
                // Box-Muller; u in (0, 1]
                let u = (f64::from(pair[0]) + 1.0) / 4_294_967_296.0;
                let angle = std::f64::consts::TAU * f64::from(pair[1]) / 4_294_967_296.0;
                let radius = (-2.0 * libm::log(u)).sqrt();
                out.extend([radius * libm::cos(angle), radius * libm::sin(angle)].map(|v| v as f32));
            }
        }
        out.truncate(count);
        out
    }

    /// A permutation of 0..`count`.
    pub fn permutation(&self, count: usize) -> Vec<usize> {
        let mut order: Vec<usize> = (0..count).collect();
        for i in (1..count).rev() {
            order.swap(i, self.below(i as u64, i as u64 + 1) as usize);
        }
        order
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn philox_gives_the_known_answers_of_its_authors() {
        assert_eq!(Noise::new(0, 0).block(0), [0x6627_e8d5, 0xe169_c58d, 0xbc57_ac4c, 0x9b00_dbd8]);
        assert_eq!(
            Noise::new(u64::MAX, u64::MAX).block(u64::MAX),
            [0x408f_276d, 0x41c8_3b0e, 0xa20b_c7c6, 0x6d54_51fd]
        );
    }

    #[test]
    fn normals_have_mean_zero_and_variance_one_and_do_not_depend_on_the_count() {
        let noise = Noise::new(7, 3);
        let n = noise.normals(100_000);
        let mean = n.iter().map(|v| f64::from(*v)).sum::<f64>() / 1e5;
        let variance = n.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>() / 1e5;
        assert!(mean.abs() < 0.01 && (variance - 1.0).abs() < 0.02, "{mean} {variance}");
        assert_eq!(noise.normals(10), n[..10]);
    }

    #[test]
    fn a_permutation_holds_every_index_once() {
        let mut order = Noise::new(1, 2).permutation(1000);
        assert_ne!(order[..5], [0, 1, 2, 3, 4]);
        order.sort_unstable();
        assert!(order.iter().enumerate().all(|(i, v)| i == *v));
    }
}
