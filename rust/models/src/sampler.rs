//! Sampling plans: DDPM with all steps, DDIM with few, classifier-free guidance against G = identity.

use crate::batch::{Batch, row_offsets};
use crate::ccdiff::Network;
use crate::error::{ModelError, Result};
use crate::noise::Noise;
use crate::schedule::Schedule;
use serde::{Deserialize, Serialize};
use tch::{Kind, Tensor};

/// How the reverse process is run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Solver {
    /// All K steps, noise added after each but the last (paper).
    Ddpm,
    /// A few evenly spaced steps, deterministic after the first noise.
    Ddim {
        /// Network evaluations, at least 1.
        steps: usize,
    },
}

/// Options of a sampling run.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SampleOptions {
    /// Reverse process.
    pub solver: Solver,
    /// Samples per plan N.
    pub num_samples: usize,
    /// Weight w of the conditional branch, (1 - w) · uncond + w · cond with w in [1, 2); 1 runs it alone (method.md 9, row 1).
    pub guidance_weight: f64,
}

impl Default for SampleOptions {
    /// One sample by DDIM in five steps, conditional branch alone.
    fn default() -> Self {
        Self { solver: Solver::Ddim { steps: 5 }, num_samples: 1, guidance_weight: 1.0 }
    }
}

impl SampleOptions {
    /// Checks ranges.
    ///
    /// # Errors
    /// [`ModelError::Config`] names the field.
    pub fn validated(self) -> Result<Self> {
        let fail = |field: &'static str, got: String, expected: &'static str| {
            Err(ModelError::Config { field, got, expected })
        };
        if self.num_samples == 0 {
            return fail("num_samples", "0".into(), "at least 1");
        }
        if !(1.0..2.0).contains(&self.guidance_weight) {
            return fail("guidance_weight", self.guidance_weight.to_string(), "a number in [1, 2)");
        }
        if self.solver == (Solver::Ddim { steps: 0 }) {
            return fail("solver.steps", "0".into(), "at least 1");
        }
        Ok(self)
    }
}

/// Standard normal noise [N · R, knots, 2], sample by sample. A world's numbers depend on its own seed, the stream and
/// its own agents alone, not on the worlds beside it.
fn noise(batch: &Batch, seeds: &[u64], stream: u64, samples: usize, per_row: usize) -> Vec<f32> {
    let rows: usize = batch.scene_sizes.iter().sum();
    let mut out = vec![0.0; samples * rows * per_row];
    for ((size, offset), seed) in batch.scene_sizes.iter().zip(row_offsets(&batch.scene_sizes)).zip(seeds) {
        let numbers = Noise::new(*seed, stream).normals(samples * size * per_row);
        for (sample, part) in numbers.chunks_exact((size * per_row).max(1)).enumerate() {
            let at = (sample * rows + offset) * per_row;
            out[at..at + part.len()].copy_from_slice(part);
        }
    }
    out
}

/// Draws normalised knots [N · R, knots, 2] (sample by sample). `seeds` holds one seed per scene of the batch.
///
/// Differs from the released code: the first, pure-noise plan is rolled out like the others (method.md 2.8).
///
/// # Errors
/// [`ModelError::Shape`] for a wrong number of seeds, [`ModelError::Config`] for bad options.
pub fn sample(
    network: &Network,
    schedule: &Schedule,
    batch: &Batch,
    seeds: &[u64],
    options: SampleOptions,
) -> Result<Tensor> {
    let options = options.validated()?;
    if seeds.len() != batch.scene_sizes.len() {
        return Err(ModelError::Shape {
            what: "seeds",
            got: seeds.len().to_string(),
            expected: format!("{} (one per scene)", batch.scene_sizes.len()),
        });
    }
    let knots = network.config().num_knots();
    let device = batch.speed_mps.device();
    let rows = options.num_samples as i64 * batch.num_rows();
    let normal = |stream: u64| {
        let values = noise(batch, seeds, stream, options.num_samples, knots * 2);
        Tensor::from_slice(&values).view([rows, knots as i64, 2]).to_device(device)
    };
    let repeat = |b: &Batch| {
        let context = network.encode(b, false);
        if options.num_samples == 1 { context } else { context.repeated(options.num_samples as i64) }
    };
    let cond = repeat(batch);
    let w = options.guidance_weight;
    let uncond = (w > 1.0).then(|| repeat(&batch.with_identity_graph(network.config())));
    let clean = |x: &Tensor, k: usize| {
        let steps = Tensor::full([rows], k as i64, (Kind::Int64, device));
        let x0 = network.denoise(&cond, x, &steps);
        match &uncond {
            Some(context) => network.denoise(context, x, &steps) * (1.0 - w) + x0 * w,
            None => x0,
        }
    };
    let mut x = normal(schedule.len() as u64);
    match options.solver {
        Solver::Ddpm => {
            for k in (0..schedule.len()).rev() {
                let p = schedule.posterior(k);
                x = clean(&x, k) * p.from_x0 + &x * p.from_xk;
                if k > 0 {
                    x = &x + normal(k as u64) * p.sigma;
                }
            }
        }
        Solver::Ddim { steps } => {
            let ks = schedule.spaced(steps);
            for (i, k) in ks.iter().enumerate() {
                let (from_x0, from_xk) = schedule.ddim(*k, ks.get(i + 1).copied());
                x = clean(&x, *k) * from_x0 + &x * from_xk;
            }
        }
    }
    Ok(x)
}
