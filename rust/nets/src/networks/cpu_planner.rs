//! Networks as plans are drawn from them on the kernels of this crate.

use crate::compute::cpu::{Batch, Cpu, Place};
use crate::compute::weights::{Entry, Weights};
use crate::config::ModelConfig;
use crate::error::Result;
use crate::guidance::Guidance;
use crate::inputs::features::SceneFeatures;
use crate::networks::denoised::denoised;
use crate::networks::planner::{Asked, Denoises, Drawn, PlanOptions, PlanSampler, Proposes, Weighted};
use crate::sampling::plan_space::PlanSpace;
use crate::sampling::sampler::Rows;
use crate::sampling::schedule::Schedule;
use std::collections::BTreeMap;
use std::path::Path;

/// A network with the tensors of a file.
fn filled<N: Weighted<Cpu>>(
    path: &Path,
    config: &ModelConfig,
    tensors: BTreeMap<String, Entry>,
) -> Result<N> {
    let weights = Weights::new(path, tensors);
    let network = N::new(&Place::root(&weights), config);
    weights.finish().map(|()| network)
}

/// A network that denoises, with the tensors of a file.
///
/// # Errors
/// [`crate::ModelError::Checkpoint`] where a tensor does not fit.
pub fn denoising<N: Denoises<Cpu> + Send + 'static>(
    path: &Path,
    config: &ModelConfig,
    tensors: BTreeMap<String, Entry>,
) -> Result<Box<dyn PlanSampler>> {
    let network: N = filled(path, config, tensors)?;
    Ok(Box::new(Denoising { network, schedule: Schedule::cosine(config.diffusion_steps)? }))
}

/// A network that plans at once, with the tensors of a file.
///
/// # Errors
/// As [`denoising`].
pub fn proposing<N: Proposes<Cpu> + Send + 'static>(
    path: &Path,
    config: &ModelConfig,
    tensors: BTreeMap<String, Entry>,
) -> Result<Box<dyn PlanSampler>> {
    let network: N = filled(path, config, tensors)?;
    Ok(Box::new(Proposing { network, space: PlanSpace::new(config) }))
}

/// Agents of each scene, and the seeds of their own noise.
fn sizes(scenes: &[&SceneFeatures]) -> (Vec<usize>, Vec<Option<u64>>) {
    let seeds = scenes.iter().flat_map(|s| s.noise_seed.iter().copied());
    (scenes.iter().map(|s| s.agents.len()).collect(), seeds.collect())
}

/// Plans of clean knots, sample by sample.
pub fn drawn(
    space: &PlanSpace,
    scenes: &[&SceneFeatures],
    knots: Vec<f32>,
    attention: Option<Vec<f32>>,
) -> Drawn {
    let actions = space.actions(&knots);
    let speed_mps: Vec<f32> = scenes.iter().flat_map(|s| s.speed_mps.iter().copied()).collect();
    Drawn { states: space.states(&actions, &speed_mps), actions, knots, attention }
}

/// A network that plans at once.
#[derive(Debug)]
struct Proposing<N> {
    network: N,
    space: PlanSpace,
}

impl<N: Proposes<Cpu> + Send> PlanSampler for Proposing<N> {
    fn draw(
        &self,
        scenes: &[&SceneFeatures],
        seeds: &[u64],
        options: &PlanOptions,
        guide: Option<&mut Guidance<'_>>,
    ) -> Result<Drawn> {
        let (scene_sizes, noise_seeds) = sizes(scenes);
        let rows = Rows { scene_sizes: &scene_sizes, noise_seeds: &noise_seeds };
        let asked = Asked { rows, seeds, options: options.sampling };
        let knots = self.network.propose(&Batch { scenes, alone: false }, &asked, guide)?;
        Ok(drawn(&self.space, scenes, knots, None))
    }
}

/// A network that denoises, with its schedule.
#[derive(Debug)]
struct Denoising<N> {
    network: N,
    schedule: Schedule,
}

impl<N: Denoises<Cpu> + Send> PlanSampler for Denoising<N> {
    fn draw(
        &self,
        scenes: &[&SceneFeatures],
        seeds: &[u64],
        options: &PlanOptions,
        guide: Option<&mut Guidance<'_>>,
    ) -> Result<Drawn> {
        let (network, config) = (&self.network, self.network.config());
        let (scene_sizes, noise_seeds) = sizes(scenes);
        let rows = Rows { scene_sizes: &scene_sizes, noise_seeds: &noise_seeds };
        let batch = |alone| Batch { scenes, alone };
        let alone = (options.sampling.guidance_weight > 1.0).then(|| batch(true));
        let asked = Asked { rows, seeds, options: options.sampling };
        let made = denoised(network, &self.schedule, &batch(false), alone.as_ref(), &asked, guide)?;
        let num_knots = config.num_knots();
        let slots = N::slots(&made.context).filter(|_| options.attention);
        let attention = slots.map(|pairs| {
            let executed = options.executed_tokens(config);
            let slots = scenes.iter().map(|s| s.num_slots).max().unwrap_or(1);
            let per_row = rows.count() * slots;
            let tokens = config.history_token_steps().len() + num_knots;
            let mut mean = vec![0.0; per_row];
            for weights in &made.attention {
                let spread = pairs.spread(weights, slots);
                for (mean, of_tokens) in mean.iter_mut().zip(spread.chunks_exact(tokens)) {
                    let of_plan = &of_tokens[tokens - num_knots..][..executed];
                    *mean += of_plan.iter().sum::<f32>() / (executed * made.attention.len()) as f32;
                }
            }
            mean
        });
        Ok(drawn(network.space(), scenes, made.knots, attention))
    }
}
