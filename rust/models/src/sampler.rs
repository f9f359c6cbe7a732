//! Sampling plans: DDPM with all steps, DDIM with few, classifier-free guidance against G = identity, guidance by losses.

use crate::batch::Batch;
use crate::diffusion::Denoiser;
use crate::error::{ModelError, Result};
use crate::features::row_offsets;
use crate::guidance::{Guidance, GuidanceStep, Target};
use crate::noise::Noise;
use crate::schedule::Schedule;
use ccdiff_sim::options;
use ccdiff_sim::options::{at_least, within};
use tch::{Device, Kind, Tensor};

options! {
    /// How plans are drawn from a network.
    #[derive(Clone, Copy)]
    #[serde(deny_unknown_fields, default)]
    pub struct SampleOptions {
        /// Network evaluations of DDIM, evenly spaced, deterministic after the first noise; `None`: DDPM with all K steps, noise
        /// added after each but the last (paper).
        solver_steps: Option<usize> = Some(5), range at_least(1.0);
        /// Samples per plan N.
        num_samples: usize = 1, range at_least(1.0);
        /// Weight w of the conditional branch, (1 - w) · uncond + w · cond; 1 runs it alone (reference.md#open-points).
        guidance_weight: f64 = 1.0, range within(1.0, 2.0).open_above();
    }
}

impl SampleOptions {
    /// Checks ranges.
    ///
    /// # Errors
    /// [`ModelError::Sim`] names the field.
    pub fn validated(self) -> Result<Self> {
        options::check("", &self)?;
        Ok(self)
    }
}

/// Checks that there is one seed per scene.
pub(crate) fn check_seeds(batch: &Batch, seeds: &[u64]) -> Result<()> {
    if seeds.len() == batch.scene_sizes.len() {
        return Ok(());
    }
    Err(ModelError::Shape {
        what: "seeds",
        got: seeds.len().to_string(),
        expected: format!("{} (one per scene)", batch.scene_sizes.len()),
    })
}

/// Standard normal noise [N · R, numbers per row], sample by sample. A world's numbers depend on its own seed, the stream and
/// its own agents alone, not on the worlds beside it. Rows with a seed of their own take theirs instead.
pub(crate) fn noise(batch: &Batch, seeds: &[u64], stream: u64, samples: usize, per_row: usize) -> Vec<f32> {
    let rows: usize = batch.scene_sizes.iter().sum();
    let mut out = vec![0.0; samples * rows * per_row];
    for ((size, offset), seed) in batch.scene_sizes.iter().zip(row_offsets(&batch.scene_sizes)).zip(seeds) {
        let numbers = Noise::new(*seed, stream).normals(samples * size * per_row);
        for (sample, part) in numbers.chunks_exact((size * per_row).max(1)).enumerate() {
            let at = (sample * rows + offset) * per_row;
            out[at..at + part.len()].copy_from_slice(part);
        }
    }
    for (row, seed) in batch.noise_seeds.iter().enumerate().filter_map(|(row, seed)| Some((row, (*seed)?))) {
        let numbers = Noise::new(seed, stream).normals(samples * per_row);
        for (sample, part) in numbers.chunks_exact(per_row).enumerate() {
            let at = (sample * rows + row) * per_row;
            out[at..at + per_row].copy_from_slice(part);
        }
    }
    out
}

/// What a sampling run gives.
#[derive(Debug)]
pub struct Samples {
    /// Clean normalised knots [N · R, knots, 2], sample by sample.
    pub knots: Tensor,
    /// Attention of the last denoising step's conditional pass in the first edge-aware layer, mean of heads,
    /// [N · R, K, tokens]; `None` for a network without it.
    pub attention: Option<Tensor>,
}

/// From a noisy plan and the clean one predicted from it to the mean of the next one.
struct StepCoefficients {
    k: usize,
    from_x0: f64,
    from_xk: f64,
    /// Standard deviation of the step, or of the random step that it stands for.
    sigma: f64,
}

/// Draws normalised knots. `seeds` holds one seed per scene of the batch; `guide` moves plans in every step but the last, whose
/// standard deviation is zero (as released, reference.md#sampling), or in the only one.
///
/// Differs from the released code: the first, pure-noise plan is rolled out like the others (reference.md#schedule).
///
/// # Errors
/// [`ModelError::Shape`] for a wrong number of seeds, [`ModelError::Config`] for bad options.
pub fn sample<D: Denoiser>(
    network: &D,
    schedule: &Schedule,
    batch: &Batch,
    seeds: &[u64],
    options: SampleOptions,
    mut guide: Option<&mut Guidance<'_>>,
) -> Result<Samples> {
    let options = options.validated()?;
    check_seeds(batch, seeds)?;
    let knots = network.space().config().num_knots();
    let device = batch.speed_mps.device();
    let rows = options.num_samples as i64 * batch.num_rows();
    let normal = |stream: u64| {
        let values = noise(batch, seeds, stream, options.num_samples, knots * 2);
        Tensor::from_slice(&values).view([rows, knots as i64, 2]).to_device(device)
    };
    let repeat = |b: &Batch| {
        let context = network.encode(b, false);
        if options.num_samples == 1 { context } else { D::repeated(&context, options.num_samples as i64) }
    };
    let cond = repeat(batch);
    let w = options.guidance_weight;
    let uncond = (w > 1.0).then(|| repeat(&batch.with_identity_graph(network.space().config())));
    let mut attention = None;
    let first = batch.first_knots.as_ref().map(|(values, tied)| {
        let n = options.num_samples as i64;
        (network.space().normalised(values).repeat([n, 1]), tied.repeat([n, 1]))
    });
    let tied = |x0: Tensor| match &first {
        Some((values, tied)) => {
            let start = values.where_self(tied, &x0.select(1, 0)).unsqueeze(1);
            Tensor::cat(&[start, x0.narrow(1, 1, knots as i64 - 1)], 1)
        }
        None => x0,
    };
    let mut clean = |x: &Tensor, k: usize| {
        let steps = Tensor::full([rows], k as i64, (Kind::Int64, device));
        let (x0, weights) = network.predict(&cond, x, &steps);
        attention = weights;
        tied(match &uncond {
            Some(context) => network.predict(context, x, &steps).0 * (1.0 - w) + x0 * w,
            None => x0,
        })
    };
    let mut mean = |x: &Tensor, step: &StepCoefficients| -> Result<Tensor> {
        let x0 = clean(x, step.k);
        match guide.as_deref_mut().filter(|g| g.is_active() && step.sigma > 0.0) {
            Some(guide) => guided_mean(guide, schedule, x, &x0, step),
            None => Ok(x0 * step.from_x0 + x * step.from_xk),
        }
    };
    let mut x = normal(schedule.len() as u64);
    match options.solver_steps {
        None => {
            for k in (0..schedule.len()).rev() {
                let p = schedule.posterior(k);
                x = mean(
                    &x,
                    &StepCoefficients { k, from_x0: p.from_x0, from_xk: p.from_xk, sigma: p.sigma },
                )?;
                if k > 0 {
                    x = &x + normal(k as u64) * p.sigma;
                }
            }
        }
        Some(steps) => {
            let ks = schedule.timesteps(steps);
            for (i, &k) in ks.iter().enumerate() {
                let to = ks.get(i + 1).copied();
                let (from_x0, from_xk) = schedule.ddim(k, to);
                // the plan of a single step is guided against the spread of the noise that it is made of
                let sigma = if steps == 1 { 1.0 } else { schedule.posterior_std(k, to) };
                x = mean(&x, &StepCoefficients { k, from_x0, from_xk, sigma })?;
            }
        }
    }
    Ok(Samples { knots: x, attention })
}

/// The mean of a step with guidance on it, or on the clean plan that it is formed from.
fn guided_mean(
    guide: &mut Guidance<'_>,
    schedule: &Schedule,
    x: &Tensor,
    x0: &Tensor,
    step: &StepCoefficients,
) -> Result<Tensor> {
    let target = guide.config().target;
    let score = guide.wants_score().then(|| {
        let alpha_bar = schedule.alpha_bar[step.k];
        to_vec(&((x0 * alpha_bar.sqrt() - x) / (1.0 - alpha_bar)))
    });
    let mean_of = |x0: &Tensor| x0 * step.from_x0 + x * step.from_xk;
    let mut adjusted = |plan: &Tensor, gain: f64| -> Result<Tensor> {
        let mut values = to_vec(plan);
        guide.adjust(&mut values, GuidanceStep { sigma: step.sigma, gain, score: score.as_deref() })?;
        Ok(Tensor::from_slice(&values).view_as(plan).to_device(plan.device()))
    };
    match target {
        Target::Mu => adjusted(&mean_of(x0), 1.0),
        Target::X0 => Ok(mean_of(&adjusted(x0, step.from_x0)?)),
    }
}

/// The numbers of a tensor.
pub(crate) fn to_vec(tensor: &Tensor) -> Vec<f32> {
    let flat = tensor.to_device(Device::Cpu).contiguous();
    let count = flat.numel();
    let mut values = vec![0f32; count];
    flat.view([-1]).copy_data(&mut values, count);
    values
}
