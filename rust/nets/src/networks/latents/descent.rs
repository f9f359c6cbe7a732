//! Guidance of networks that plan from latents: descent in the latents (rivals.md#guidance).
//!
//! Objectives know plans as numbers, so their gradient g with respect to the knots is taken as a constant of each step:
//! the gradient of g · x(z) with respect to z is then exact.

use super::LOG_VARIANCE;
use crate::guidance::Guidance;

const BETA: (f32, f32) = (0.9, 0.999);
/// Largest norm of a row's gradient: those through 52 steps of the unicycle grow with time.
const CLIP_NORM: f32 = 10.0;

/// A Gaussian for each of R rows, independent in D numbers, [R · D].
#[derive(Debug)]
pub(super) struct Gaussian {
    mean: Vec<f32>,
    std: Vec<f32>,
}

impl Gaussian {
    /// From D means and D logarithms of variances per row, which are bounded.
    pub(super) fn new(numbers: &[f32], latent: usize) -> Self {
        let (low, high) = LOG_VARIANCE;
        let std = |v: &f32| libm::exp(0.5 * f64::from(*v).clamp(low, high)) as f32;
        let rows = || numbers.chunks_exact(2 * latent);
        Self {
            mean: rows().flat_map(|row| &row[..latent]).copied().collect(),
            std: rows().flat_map(|row| &row[latent..]).map(std).collect(),
        }
    }

    /// N(0, I).
    #[cfg(test)]
    fn standard(numbers: usize) -> Self {
        Self { mean: vec![0.0; numbers], std: vec![1.0; numbers] }
    }

    /// Samples from standard normal noise [N · R · D].
    pub(super) fn sample(&self, noise: &[f32]) -> Vec<f32> {
        let parameters = self.mean.iter().zip(&self.std).cycle();
        noise.iter().zip(parameters).map(|(x, (mean, std))| mean + std * x).collect()
    }
}

/// Latents [N · R, D] that guidance prefers to `start`, found by Adam; rows that are not guided keep their bits. With a
/// prior, ½‖(z − μ)/σ‖², mean over the agents of a world, is minimised as well. `pulled` makes gradients by latents of those by knots.
pub(super) fn descended(
    start: &[f32],
    latent: usize,
    prior: Option<&Gaussian>,
    guide: &Guidance<'_>,
    decode: impl Fn(&[f32]) -> Vec<f32>,
    pulled: impl Fn(&[f32], &[f32]) -> Vec<f32>,
) -> Vec<f32> {
    let (scales, config) = (guide.row_scales(), guide.config());
    let (mut z, mut first, mut second) = (start.to_vec(), vec![0f32; start.len()], vec![0f32; start.len()]);
    let mut unbias = (1f32, 1f32);
    for _ in 0..config.gradient_steps {
        unbias = (unbias.0 * BETA.0, unbias.1 * BETA.1);
        let mut gradient = pulled(&z, &guide.gradient(&decode(&z)));
        if let Some(prior) = prior {
            add_prior(&mut gradient, &z, latent, prior, &scales);
        }
        for (row, gradient) in
            gradient.chunks_exact(latent).enumerate().filter(|(row, _)| scales[*row][0] > 0.0)
        {
            let norm = gradient.iter().map(|g| g * g).sum::<f32>().sqrt();
            let clip = CLIP_NORM / norm.max(CLIP_NORM);
            for (at, g) in (row * latent..).zip(gradient) {
                let g = g * clip;
                first[at] = first[at] * BETA.0 + g * (1.0 - BETA.0);
                second[at] = second[at] * BETA.1 + g * g * (1.0 - BETA.1);
                let spread = (second[at] / (1.0 - unbias.1)).sqrt() + 1e-8;
                z[at] -= first[at] / (1.0 - unbias.0) / spread * config.learning_rate * scales[row][0];
            }
        }
    }
    z
}

/// Adds the gradient of the distance from a prior; `scales` are those of [`Guidance::row_scales`].
fn add_prior(gradient: &mut [f32], z: &[f32], latent: usize, prior: &Gaussian, scales: &[[f32; 2]]) {
    let parameters = prior.mean.iter().zip(&prior.std).cycle();
    for (at, ((g, z), (mean, std))) in gradient.iter_mut().zip(z).zip(parameters).enumerate() {
        *g += scales[at / latent][1] * (z - mean) / (std * std);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_and_the_gradient_of_a_prior_have_the_tabulated_values() {
        // ln σ² is bounded: those of the last two numbers are -6 and 2
        let prior = Gaussian::new(&[0.5, -1.0, 2.0, 0.4, -9.0, 9.0], 3);
        let z = prior.sample(&[1.0, 2.0, -1.0]);
        for (got, want) in z.iter().zip([0.5 + 0.2f32.exp(), -1.0 + 2.0 * (-3f32).exp(), 2.0 - 1f32.exp()]) {
            assert!((got - want).abs() < 1e-6, "{z:?}");
        }
        // tabulated in float64: z / M
        let mut gradient = vec![-0.75, -2.0];
        add_prior(&mut gradient, &[0.3, -0.2], 2, &Gaussian::standard(2), &[[1.0, 0.25]]);
        assert!((gradient[0] + 0.675).abs() < 1e-6 && (gradient[1] + 2.05).abs() < 1e-6);
    }
}
