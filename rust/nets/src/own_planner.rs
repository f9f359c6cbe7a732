//! Networks as plans are drawn from them on the kernels of this crate.

use crate::ccdiff::{Context, Network};
use crate::config::ModelConfig;
use crate::error::Result;
use crate::features::SceneFeatures;
use crate::guidance::Guidance;
use crate::own::{Array, Inputs, Own, Place};
use crate::plan_space::PlanSpace;
use crate::planner::{Drawn, PlanOptions, Planner};
use crate::sampler::{self, Draws, Predict, Rows};
use crate::schedule::Schedule;
use crate::simnet::Simnet;
use crate::weights::{Entry, Weights};
use std::collections::BTreeMap;
use std::path::Path;

/// Worlds that share a batch: as many as leave a layer's numbers in the cache.
const MOST_WORLDS: usize = 2;

/// Scene diffusion with the tensors of a file.
///
/// # Errors
/// [`crate::ModelError::Config`] for a network that needs torch, [`crate::ModelError::Checkpoint`] where a tensor does not fit.
pub(crate) fn denoiser(
    path: &Path,
    config: &ModelConfig,
    tensors: BTreeMap<String, Entry>,
) -> Result<Box<dyn Planner>> {
    let weights = Weights::new(path, tensors);
    let network = Network::new(&Place::root(&weights), config);
    weights.finish()?;
    Ok(Box::new(Denoiser { network, schedule: Schedule::cosine(config.diffusion_steps)? }))
}

/// SimNet with the tensors of a file.
///
/// # Errors
/// As [`denoiser`].
pub(crate) fn regressor(
    path: &Path,
    config: &ModelConfig,
    tensors: BTreeMap<String, Entry>,
) -> Result<Box<dyn Planner>> {
    let weights = Weights::new(path, tensors);
    let network = Simnet::new(&Place::root(&weights), config);
    weights.finish()?;
    Ok(Box::new(Regressor { network, space: PlanSpace::new(config) }))
}

/// Plans of clean knots, sample by sample.
fn drawn(
    space: &PlanSpace,
    scenes: &[&SceneFeatures],
    knots: Vec<f32>,
    attention: Option<Vec<f32>>,
) -> Drawn {
    let actions = space.actions(&knots);
    let speed_mps: Vec<f32> = scenes.iter().flat_map(|s| s.speed_mps.iter().copied()).collect();
    Drawn { states: space.states(&actions, &speed_mps), actions, knots, attention }
}

/// SimNet.
#[derive(Debug)]
struct Regressor {
    network: Simnet<Own>,
    space: PlanSpace,
}

impl Planner for Regressor {
    fn most_worlds(&self) -> usize {
        MOST_WORLDS
    }

    /// The one plan, N times.
    fn draw(
        &self,
        scenes: &[&SceneFeatures],
        seeds: &[u64],
        options: &PlanOptions,
        guide: Option<&mut Guidance<'_>>,
    ) -> Result<Drawn> {
        let sizes: Vec<usize> = scenes.iter().map(|s| s.agents.len()).collect();
        Rows { scene_sizes: &sizes, noise_seeds: &[] }.check_seeds(seeds)?;
        let plan = self.network.plan(&Inputs { scenes, alone: false }, false);
        let mut knots = plan.into_numbers().repeat(options.sampling.num_samples);
        if let Some(guide) = guide {
            guide.adjust_finished(&mut knots)?;
        }
        Ok(drawn(&self.space, scenes, knots, None))
    }
}

/// CCDiff and CTG++ with their schedule.
#[derive(Debug)]
struct Denoiser {
    network: Network<Own>,
    schedule: Schedule,
}

/// A network on scenes that it has encoded.
struct Encoded<'a> {
    network: &'a Network<Own>,
    with_graph: Context<Own>,
    alone: Option<Context<Own>>,
    /// Numbers of the noisy plans of one sample.
    per_sample: usize,
    /// Weights of the last pass with the graph, of each sample.
    attention: Vec<Vec<f32>>,
}

impl Predict for Encoded<'_> {
    fn predict(&mut self, noisy: &[f32], step: usize, alone: bool) -> Vec<f32> {
        let context = self.alone.as_ref().filter(|_| alone).unwrap_or(&self.with_graph);
        if !alone {
            self.attention.clear();
        }
        let mut clean = Vec::with_capacity(noisy.len());
        for sample in noisy.chunks_exact(self.per_sample) {
            let noisy = Array::new(self.network.config().num_knots(), 2, sample.to_vec());
            let (knots, attention) = self.network.denoise(context, &noisy, &step);
            clean.extend(knots.into_numbers());
            if !alone {
                self.attention.extend(attention);
            }
        }
        clean
    }
}

impl Planner for Denoiser {
    fn most_worlds(&self) -> usize {
        MOST_WORLDS
    }

    fn draw(
        &self,
        scenes: &[&SceneFeatures],
        seeds: &[u64],
        options: &PlanOptions,
        guide: Option<&mut Guidance<'_>>,
    ) -> Result<Drawn> {
        let (network, config) = (&self.network, self.network.config());
        let sizes: Vec<usize> = scenes.iter().map(|s| s.agents.len()).collect();
        let noise_seeds: Vec<Option<u64>> =
            scenes.iter().flat_map(|s| s.noise_seed.iter().copied()).collect();
        let rows = Rows { scene_sizes: &sizes, noise_seeds: &noise_seeds };
        let n = &config.normalisation;
        let normalised =
            |action: [f32; 2]| [0, 1].map(|c| (action[c] - n.action_mean[c] as f32) / n.action_std[c] as f32);
        let first: Vec<Option<[f32; 2]>> =
            scenes.iter().flat_map(|s| s.first_action.iter().map(|a| a.map(normalised))).collect();
        let num_knots = config.num_knots();
        let encode = |alone| network.encode(&Inputs { scenes, alone }, false);
        let mut encoded = Encoded {
            network,
            with_graph: encode(false),
            alone: (options.sampling.guidance_weight > 1.0).then(|| encode(true)),
            per_sample: rows.count() * num_knots * 2,
            attention: Vec::new(),
        };
        let sampling = options.sampling;
        let draws =
            Draws { schedule: &self.schedule, rows, seeds, options: sampling, num_knots, first: &first };
        let knots = sampler::sample(&draws, &mut encoded, guide)?;
        let attention = options.attention.then(|| {
            let executed = options.executed_tokens(config);
            let slots = scenes.iter().map(|s| s.num_slots).max().unwrap_or(1);
            let per_row = rows.count() * slots;
            let tokens = config.history_token_steps().len() + num_knots;
            let mut mean = vec![0.0; per_row];
            for weights in &encoded.attention {
                let spread = encoded.with_graph.slots.spread(weights, slots);
                for (mean, of_tokens) in mean.iter_mut().zip(spread.chunks_exact(tokens)) {
                    let of_plan = &of_tokens[tokens - num_knots..][..executed];
                    *mean += of_plan.iter().sum::<f32>() / (executed * encoded.attention.len()) as f32;
                }
            }
            mean
        });
        Ok(drawn(network.space(), scenes, knots, attention))
    }
}
