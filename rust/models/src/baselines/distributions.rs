//! Diagonal Gaussians of latents.

use ccdiff_nets::networks::latents::LOG_VARIANCE;
use tch::{Kind, Tensor};

/// A Gaussian for each of R rows, independent in D numbers.
#[derive(Debug)]
pub(super) struct Gaussian {
    /// [R, D].
    pub(super) mean: Tensor,
    /// ln σ² [R, D].
    pub(super) log_variance: Tensor,
}

impl Gaussian {
    /// From 2 D numbers per row, the logarithms of the variances bounded.
    pub(super) fn new(numbers: &Tensor) -> Self {
        let parts = numbers.chunk(2, 1);
        Self { mean: parts[0].shallow_clone(), log_variance: parts[1].clamp(LOG_VARIANCE.0, LOG_VARIANCE.1) }
    }

    /// N(0, I) of as many rows and numbers.
    #[cfg(test)]
    pub(super) fn standard(like: &Tensor) -> Self {
        let zeros = like.zeros_like();
        Self { mean: zeros.shallow_clone(), log_variance: zeros }
    }

    pub(super) fn std(&self) -> Tensor {
        (&self.log_variance * 0.5).exp()
    }

    /// Samples from standard normal noise [R, D].
    pub(super) fn sample(&self, noise: &Tensor) -> Tensor {
        &self.mean + self.std() * noise
    }

    /// KL divergence from `prior` of each row, [R]: ½ Σ [ln p_v − ln q_v + (q_v + (q_μ − p_μ)²)/p_v − 1].
    pub(super) fn kl(&self, prior: &Self) -> Tensor {
        let ratio = (&self.log_variance - &prior.log_variance).exp();
        let off = (&self.mean - &prior.mean).square() / prior.log_variance.exp();
        let sum = &prior.log_variance - &self.log_variance + ratio + off - 1.0;
        sum.sum_dim_intlist([1i64].as_slice(), false, Kind::Float) * 0.5
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gaussian(mean: &[f32], log_variance: &[f32]) -> Gaussian {
        let row = |v: &[f32]| Tensor::from_slice(v).view([1, -1]);
        Gaussian { mean: row(mean), log_variance: row(log_variance) }
    }

    #[test]
    fn divergences_have_the_tabulated_values() {
        // tabulated in float64
        let q = gaussian(&[0.5, -1.0, 0.25, 2.0], &[-0.5, 0.3, -2.0, 0.1]);
        let standard = Gaussian::standard(&q.mean);
        assert!((q.kl(&standard).double_value(&[0]) - 3.304_698).abs() < 1e-5);
        assert!(standard.kl(&standard).double_value(&[0]).abs() < 1e-7);
        let q = gaussian(&[0.5, -1.0], &[-0.5, 0.3]);
        let p = gaussian(&[0.2, 0.1], &[0.4, -0.2]);
        assert!((q.kl(&p).double_value(&[0]) - 0.996_759).abs() < 1e-5);
        assert!((p.kl(&q).double_value(&[0]) - 0.855_454).abs() < 1e-5);
    }
}
