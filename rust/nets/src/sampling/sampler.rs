//! Sampling plans: DDPM with all steps, DDIM with few, classifier-free guidance against G = identity, guidance by losses.

use crate::error::Result;
use crate::guidance::{Guidance, Guide, Target};
use crate::inputs::features::row_offsets;
use crate::sampling::noise::Noise;
use crate::sampling::schedule::{Posterior, Schedule};
use ccdiff_sim::options;
use ccdiff_sim::options::within;

/// Correlation of the noise of a row's plans with the noise that the row keeps.
const KEPT_NOISE: f32 = 0.5;

options! {
    /// How plans are drawn from a network.
    #[derive(Clone, Copy)]
    #[serde(deny_unknown_fields, default)]
    pub struct SampleOptions {
        /// Network evaluations of DDIM, evenly spaced, deterministic after the first noise; `None`: DDPM with all K steps, noise
        /// added after each but the last (paper).
        solver_steps: Option<usize> = Some(5), range within(1.0, 1000.0);
        /// Samples per plan N.
        num_samples: usize = 1, range within(1.0, 1024.0);
        /// Weight w of the conditional branch, (1 - w) · uncond + w · cond; 1 runs it alone (reference.md#open-points).
        guidance_weight: f64 = 1.0, range within(1.0, 2.0).open_above();
        /// As that of `CcdiffConfig`.
        temperature: f64 = 1.0, range within(0.0, 100.0).open_below();
    }
}

impl SampleOptions {
    /// Checks ranges.
    ///
    /// # Errors
    /// [`crate::ModelError::Sim`] names the field.
    pub fn validated(self) -> Result<Self> {
        options::check("", &self)?;
        Ok(self)
    }
}

/// The rows that plans are drawn for.
#[derive(Debug, Clone, Copy)]
pub struct Rows<'a> {
    /// Agents of each scene, summing up to R.
    pub scene_sizes: &'a [usize],
    /// Seed of each row's own noise [R]; `None`: noise of the world's seed.
    pub noise_seeds: &'a [Option<u64>],
}

impl Rows<'_> {
    /// Their number R.
    pub fn count(&self) -> usize {
        self.scene_sizes.iter().sum()
    }

    /// Standard normal noise [N · R, numbers per row], sample by sample. A world's numbers depend on its own seed, the stream and
    /// its own agents alone, not on the worlds beside it. Rows with a seed of their own share [`KEPT_NOISE`] with theirs.
    pub fn noise(&self, seeds: &[u64], stream: u64, samples: usize, per_row: usize) -> Vec<f32> {
        let rows = self.count();
        let mut out = vec![0.0; samples * rows * per_row];
        for ((size, offset), seed) in self.scene_sizes.iter().zip(row_offsets(self.scene_sizes)).zip(seeds) {
            let numbers = Noise::new(*seed, stream).normals(samples * size * per_row);
            for (sample, part) in numbers.chunks_exact((size * per_row).max(1)).enumerate() {
                let at = (sample * rows + offset) * per_row;
                out[at..at + part.len()].copy_from_slice(part);
            }
        }
        let fresh = (1.0 - KEPT_NOISE * KEPT_NOISE).sqrt();
        let own = self.noise_seeds.iter().enumerate().filter_map(|(row, seed)| Some((row, (*seed)?)));
        for (row, seed) in own {
            let numbers = Noise::new(seed, stream).normals(samples * per_row);
            for (sample, part) in numbers.chunks_exact(per_row).enumerate() {
                let at = (sample * rows + row) * per_row;
                let mixed = out[at..at + per_row].iter_mut().zip(part);
                mixed.for_each(|(out, own)| *out = *out * fresh + own * KEPT_NOISE);
            }
        }
        out
    }
}

/// What is drawn of a network.
#[derive(Debug, Clone, Copy)]
pub struct Asked<'a> {
    /// The rows.
    pub rows: Rows<'a>,
    /// One seed per scene.
    pub seeds: &'a [u64],
    /// How plans are drawn.
    pub options: SampleOptions,
    /// Whether plans come with the attention of so many of their first knots, where there is any.
    pub attention: Option<usize>,
}

/// a · x + b · y.
fn joined(x: &[f32], a: f64, y: &[f32], b: f64) -> Vec<f32> {
    let (a, b) = (a as f32, b as f32);
    x.iter().zip(y).map(|(x, y)| x * a + y * b).collect()
}

/// Draws clean normalised knots [N · R, knots, 2], sample by sample; `guide` moves the finished ones, or plans in every step but
/// the last, k = 0 (as released, reference.md#sampling). `predict` makes clean plans of noisy ones at a
/// diffusion step, with G = identity if it is told so.
///
/// Differs from the released code: the first, pure-noise plan is rolled out like the others (reference.md#schedule).
pub fn sample(
    schedule: &Schedule,
    num_knots: usize,
    asked: &Asked<'_>,
    mut predict: impl FnMut(&[f32], usize, bool) -> Vec<f32>,
    mut guide: Guide<'_, '_>,
) -> Vec<f32> {
    let Asked { rows, seeds, options, .. } = *asked;
    let normal = |stream: u64| rows.noise(seeds, stream, options.num_samples, num_knots * 2);
    let w = options.guidance_weight;
    let mut clean = |x: &[f32], k: usize| {
        let cond = predict(x, k, false);
        if w > 1.0 { joined(&predict(x, k, true), 1.0 - w, &cond, w) } else { cond }
    };
    // the step's mean is from_x0 · x0 + from_xk · x
    let mut mean = |x: &[f32], k: usize, step: &Posterior| -> Vec<f32> {
        let x0 = clean(x, k);
        match guide.as_deref_mut().filter(|g| g.is_active() && k > 0) {
            Some(guide) => guided_mean(guide, schedule.alpha_bar[k], x, x0, step),
            None => joined(&x0, step.from_x0, x, step.from_xk),
        }
    };
    let mut x = normal(schedule.num_steps() as u64);
    x.iter_mut().for_each(|x| *x *= options.temperature as f32);
    match options.solver_steps {
        None => {
            for k in (0..schedule.num_steps()).rev() {
                let step = schedule.posterior(k);
                x = mean(&x, k, &step);
                if k > 0 {
                    x = joined(&x, 1.0, &normal(k as u64), step.sigma);
                }
            }
        }
        Some(steps) => {
            let ks = schedule.timesteps(steps);
            for (i, &k) in ks.iter().enumerate() {
                x = mean(&x, k, &schedule.ddim(k, ks.get(i + 1).copied()));
            }
        }
    }
    if let Some(guide) = guide.filter(|g| g.config().target == Target::Finished) {
        guide.adjust_finished(&mut x);
    }
    x
}

/// The mean of a step, which guidance moves, or looks at.
fn guided_mean(
    guide: &mut Guidance<'_>,
    alpha_bar: f64,
    x: &[f32],
    mut x0: Vec<f32>,
    step: &Posterior,
) -> Vec<f32> {
    let score = guide.wants_score().then(|| {
        let (signal, noise) = (alpha_bar.sqrt() as f32, (1.0 - alpha_bar) as f32);
        x0.iter().zip(x).map(|(x0, x)| (x0 * signal - x) / noise).collect::<Vec<f32>>()
    });
    let mean = |x0: &[f32]| joined(x0, step.from_x0, x, step.from_xk);
    match guide.config().target {
        Target::Mean => {
            let mut mean = mean(&x0);
            guide.adjust(&mut mean, score.as_deref());
            mean
        }
        Target::Finished => {
            if let Some(score) = &score {
                guide.watch(&mut x0, score);
            }
            mean(&x0)
        }
    }
}
